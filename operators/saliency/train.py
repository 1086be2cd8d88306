"""Train the shipped detector: `python -m operators.saliency.train --help`.

It learns from procedural scenes and from labelled stills, where there are some. This module
defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from operators.saliency.training_settings import HEADS, TrainSettings
from operators.training.command_line import GOES_ON, add_numbers, in_a_sentence
from operators.training.ranges import DEVICES
from operators.training.splits import HELD_OUT
from pipeline.extras import need


def asked(words: Sequence[str] | None) -> tuple[TrainSettings, Path | None]:
    """Parse the command line: the settings, and the file to export to instead of training."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="rendered scenes")
    parser.add_argument("--stills", type=Path, nargs="+", default=(), help="labelled, to train on")
    parser.add_argument(
        "--leave-out", nargs="*", default=HELD_OUT, metavar="NAME",
        help="beginnings of names of stills not to train on; the test's unless given",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, help="checkpoint and log")
    parser.add_argument(
        "--export",
        type=Path,
        help="write detector.onnx here, with --width-px and --difference as trained, train nothing",
    )
    parser.add_argument(
        "--init", type=Path,
        help="checkpoint, of a training with the same --difference, or .onnx to begin with",
    )  # fmt: skip
    parser.add_argument(
        "--difference", action="store_true",
        help="add a head for a moving ball, which reads what changed since the frame before",
    )  # fmt: skip
    parser.add_argument(
        "--only",
        default="",
        choices=HEADS,
        help="train this head, or both for a ball, and leave the rest as it is",
    )
    parser.add_argument("--compiled", action="store_true", help="compile first: needs g++")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TrainSettings)
    given = vars(parser.parse_args(words))
    target = given.pop("export")
    lists = {name: tuple(given[name]) for name in ("data", "stills", "leave_out")}
    return TrainSettings(**(given | lists)), target


@in_a_sentence(GOES_ON)
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    settings, target = asked(words)
    need("torch", "train")
    from operators.saliency.model import DetectorNet
    from operators.saliency.training_run import export, train, trained_on
    from operators.training import checkpoint

    if target is not None:
        net = DetectorNet(difference=settings.difference)
        checkpoint.take(checkpoint.path_in(settings.out), {"mean": net})
        target.mkdir(parents=True, exist_ok=True)
        export(net, target / "detector.onnx", trained_on(settings), settings.width_px)
        return
    run = train(settings)
    export(run.mean, settings.out / "detector.onnx", trained_on(settings), settings.width_px)
    print(json.dumps({"step": run.step, "elapsed_s": run.elapsed_s}))


if __name__ == "__main__":
    main()
