"""Train the policy that reads: `python -m operators.policy.reading.train --help`.

This module defines the options; the training itself, which needs torch, is in
`training.py`.
"""

# mypy: disallow-untyped-decorators=False
from dataclasses import fields
from pathlib import Path

import click

from operators.policy.reading.settings import ReadingTrainSettings
from operators.policy.reading.tokens import PARTS
from operators.policy.rollout import Late
from operators.policy.train import frames_of, told
from operators.training.command_line import GOES_ON, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need

SCALES = ",".join(f"{scale:g}" for scale in ReadingTrainSettings.scales)


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--data", type=Path, required=True, help="recorded clips, created if missing")
@click.option("--out", type=Path, required=True, help="checkpoint, log, plot, reading.onnx")
@click.option("--use", default=",".join(PARTS), show_default=True, help="inputs; for ablations")
@click.option("--delays", default=told(Late.delays), show_default=True, help="frames, when late")
@click.option("--replans", default=told(Late.replans), show_default=True, help="Ta, when seldom")
@click.option(
    "--scales", default=SCALES, show_default=True, help="sides of the ROI, of the recorded"
)
@click.option("--device", default="auto", show_default=True, help=DEVICES)
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE", help="of recording")
def command(
    data: Path, out: Path, use: str, delays: str, replans: str, scales: str, device: str,
    changes: tuple[str, ...], **numbers: float,
) -> None:  # fmt: skip
    """Train the policy on roll-outs of itself."""
    parts = tuple(part for part in use.split(",") if part)
    for part in parts:
        if part not in PARTS:
            raise click.UsageError(f"--use: expected some of {', '.join(PARTS)}, got {part}")
    late = Late(delays=frames_of("--delays", delays), replans=frames_of("--replans", replans))
    try:
        sides = tuple(float(part) for part in scales.split(","))
    except ValueError:
        raise click.UsageError(f"--scales: expected shares such as 1,0.5, got {scales!r}") from None
    with in_a_sentence(GOES_ON):
        need("torch", "train")
        from operators.policy.reading.model import export
        from operators.policy.reading.training import train

        settings = ReadingTrainSettings(
            data=data, out=out, use=parts, late=late, scales=sides, device=device, changes=changes,
            **numbers,  # type: ignore[arg-type]
        )  # fmt: skip
        export(train(settings), settings.out / "reading.onnx")


for _field in fields(ReadingTrainSettings):
    if isinstance(_field.default, int | float):
        click.option(f"--{_field.name}", default=_field.default, show_default=True)(command)


if __name__ == "__main__":
    command()
