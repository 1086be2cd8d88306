"""Train the ROI encoder on procedural scenes: `python -m operators.roi_features.train --help`.

What may be asked of a training; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from operators.training.command_line import GOES_ON, add_numbers, in_a_sentence
from operators.training.ranges import DEVICES, above_zero, at_least, known_device
from pipeline.errors import SettingsError
from pipeline.extras import need

OF_SCENE = 24  # crops of one scene in a batch


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: Path
    out: Path
    scenes: int = 150
    moments: int = 10
    span: int = 900  # frames of each scene over which its moments are spread
    steps: int = 2000
    batch: int = 120
    rate: float = 2e-3
    warmup: int = 100
    decay: float = 0.02
    identity: float = 1.0  # weight of the second objective
    seed: int = 1
    threads: int = 2
    minutes: float = 30.0
    init: Path | None = None  # ImageNet weights to begin with
    head_of: Path | None = None  # checkpoint whose features are kept
    device: str = "auto"  # where the network is; crops are drawn on processors

    def __post_init__(self) -> None:
        at_least(OF_SCENE, self, "batch")
        at_least(2, self, "moments")  # nobody is known again who was seen once
        at_least(1, self, "span", "steps", "threads")
        at_least(0, self, "warmup", "decay", "identity", "seed")
        above_zero(self, "rate", "minutes")
        if self.scenes < self.batch // OF_SCENE:
            raise SettingsError(
                f"scenes: a batch of {self.batch} needs at least {self.batch // OF_SCENE}, "
                f"got {self.scenes}"
            )
        known_device(self.device)


def asked(words: Sequence[str] | None) -> TrainSettings:
    """What a command line means."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, required=True, help="rendered crops, made if missing")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint, log, roi_encoder.onnx")
    parser.add_argument("--init", type=Path, help="ImageNet weights to begin with")
    parser.add_argument("--head-of", type=Path, help="a checkpoint.pt: keep its features")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TrainSettings)
    return TrainSettings(**vars(parser.parse_args(words)))


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
