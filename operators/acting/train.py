"""Train the policy that acts, in trials of the frozen consumer: `--help` says its options.

This module defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
from dataclasses import fields
from pathlib import Path

import click

from operators.acting.training_settings import TrainSettings
from operators.training.command_line import GOES_ON, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--data", type=Path, required=True, help="trials, recorded if missing")
@click.option("--out", type=Path, required=True, help="checkpoints, logs, acting.onnx")
@click.option("--device", default="auto", show_default=True, help=DEVICES)
def command(data: Path, out: Path, device: str, **numbers: float) -> None:
    """Train the policy that acts."""
    with in_a_sentence(GOES_ON):
        need("torch", "train")
        from operators.acting.training_run import train

        train(TrainSettings(data=data, out=out, device=device, **numbers))  # type: ignore[arg-type]


for _field in fields(TrainSettings):
    if isinstance(_field.default, int | float):
        click.option(f"--{_field.name}", default=_field.default, show_default=True)(command)


if __name__ == "__main__":
    command()
