"""Train the policy on roll-outs of itself: `python -m operators.policy.train --help`.

This module defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import click

from operators.policy.rollout import Late
from operators.policy.tokens import PARTS
from operators.policy.training_settings import TrainSettings
from operators.policy.utility import UTILITIES
from operators.training.command_line import GOES_ON, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need


def told(frames: Sequence[int]) -> str:
    """Return numbers of frames as an option takes them."""
    return ",".join(str(each) for each in frames)


def frames_of(option: str, text: str) -> tuple[int, ...]:
    """Return the numbers of an option such as 1,2,4; raises `click.UsageError`."""
    try:
        found = tuple(int(part) for part in text.split(","))
    except ValueError:
        found = ()
    if not found or min(found) < 1:
        raise click.UsageError(f"{option}: expected frames such as 1,2,4, got {text!r}")
    return found


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--data", type=Path, required=True, help="recorded clips, created if missing")
@click.option("--out", type=Path, required=True, help="checkpoint, log, plot, policy.onnx")
@click.option("--use", default=",".join(PARTS), show_default=True, help="inputs; for ablations")
@click.option("--delays", default=told(Late.delays), show_default=True, help="frames, when late")
@click.option("--replans", default=told(Late.replans), show_default=True, help="Ta, when seldom")
@click.option("--utility", default="geometric", show_default=True, help=" | ".join(UTILITIES))
@click.option("--device", default="auto", show_default=True, help=DEVICES)
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE", help="of recording")
def command(
    data: Path, out: Path, use: str, delays: str, replans: str, utility: str, device: str,
    changes: tuple[str, ...], **numbers: float,
) -> None:  # fmt: skip
    """Train the policy on roll-outs of itself."""
    parts = tuple(part for part in use.split(",") if part)
    for part in parts:
        if part not in PARTS:
            raise click.UsageError(f"--use: expected some of {', '.join(PARTS)}, got {part}")
    late = Late(delays=frames_of("--delays", delays), replans=frames_of("--replans", replans))
    plain = {"data": data, "out": out, "utility": utility, "device": device, "changes": changes}
    with in_a_sentence(GOES_ON):
        need("torch", "train")
        from operators.policy.model import export
        from operators.policy.training_run import train

        settings = TrainSettings(use=parts, late=late, **plain, **numbers)  # type: ignore[arg-type]
        export(train(settings), settings.out / "policy.onnx")


for _field in fields(TrainSettings):
    if isinstance(_field.default, int | float):
        click.option(f"--{_field.name}", default=_field.default, show_default=True)(command)


if __name__ == "__main__":
    command()
