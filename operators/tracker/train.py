"""Train the template tracker on scenes and stills: `python -m operators.tracker.train --help`.

This module defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from operators.tracker.training_settings import TrainSettings
from operators.training.command_line import GOES_ON, add_numbers, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need


def asked(words: Sequence[str] | None) -> tuple[TrainSettings, bool]:
    """Parse the command line: the settings, and whether to export only."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, required=True, help="pieces, made if missing")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint, log, template.onnx")
    parser.add_argument(
        "--stills", type=Path, nargs="*", default=[],
        help="folders with images/ (and labels/), and videos; the matches held out are left out",
    )  # fmt: skip
    parser.add_argument("--export", action="store_true", help="write the checkpoint as ONNX, only")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TrainSettings)
    given = vars(parser.parse_args(words))
    only = bool(given.pop("export"))
    return TrainSettings(**given | {"stills": tuple(given["stills"])}), only


@in_a_sentence(GOES_ON)
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    settings, only = asked(words)
    need("torch", "train")
    from operators.tracker.training_run import export, kept, train

    run = kept(settings) if only else train(settings)
    path = settings.out / "template.onnx"
    export(run, path)
    print(json.dumps({"wrote": str(path), "steps": run.step}))


if __name__ == "__main__":
    main()
