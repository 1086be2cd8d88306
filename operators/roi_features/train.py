"""Train the ROI encoder on scenes and stills: `python -m operators.roi_features.train --help`.

This module defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from operators.roi_features.training_settings import TrainSettings
from operators.training.command_line import GOES_ON, add_numbers, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need


def asked(words: Sequence[str] | None) -> TrainSettings:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, required=True, help="rendered crops, made if missing")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint, log, roi_encoder.onnx")
    parser.add_argument(
        "--stills", type=Path, nargs="*", default=[],
        help="folders with images/, labels/ and data.yaml, beside the scenes",
    )  # fmt: skip
    parser.add_argument("--init", type=Path, help="ImageNet weights to begin with")
    parser.add_argument("--head-of", type=Path, help="a checkpoint.pt: keep its features")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TrainSettings)
    given = vars(parser.parse_args(words))
    return TrainSettings(**given | {"stills": tuple(given["stills"])})


@in_a_sentence(GOES_ON)
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    settings = asked(words)
    need("torch", "train")
    from operators.roi_features.training_run import export, train

    export(train(settings), settings.out / "roi_encoder.onnx")
    print(json.dumps({"wrote": str(settings.out / "roi_encoder.onnx")}))


if __name__ == "__main__":
    main()
