"""Train the shipped detector on procedural scenes: `python -m operators.saliency.train --help`.

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
from pipeline.extras import need


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: tuple[Path, ...]
    out: Path
    scenes: int = 320
    moments: int = 12
    span: int = 900  # frames of each scene over which its moments are spread
    steps: int = 4800
    batch: int = 16
    rate: float = 2e-3
    warmup: int = 300
    decay: float = 0.02
    seed: int = 1
    threads: int = 2
    minutes: float = 120.0
    compiled: bool = False
    init: Path | None = None  # a checkpoint to begin with instead of random weights
    device: str = "auto"  # where the network is; scenes are drawn on processors

    def __post_init__(self) -> None:
        at_least(1, self, "moments", "span", "steps", "batch", "threads")
        at_least(0, self, "scenes", "warmup", "decay", "seed")  # no scenes: other data alone
        above_zero(self, "rate", "minutes")
        known_device(self.device)


def asked(words: Sequence[str] | None) -> tuple[TrainSettings, Path | None]:
    """What a command line means: a training, and where to export instead of training."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="rendered scenes")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint and log")
    parser.add_argument("--export", type=Path, help="write detector.onnx here, train nothing")
    parser.add_argument("--init", type=Path, help="checkpoint whose weights to begin with")
    parser.add_argument("--compiled", action="store_true", help="compile first: needs g++")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TrainSettings)
    given = vars(parser.parse_args(words))
    target = given.pop("export")
    return TrainSettings(**(given | {"data": tuple(given["data"])})), target


@in_a_sentence(GOES_ON)
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    settings, target = asked(words)
    need("torch", "train")
    from operators.saliency.model import DetectorNet
    from operators.saliency.training_run import export, train
    from operators.training import checkpoint

    if target is not None:
        net = DetectorNet()
        checkpoint.take(checkpoint.path_in(settings.out), {"mean": net})
        export(net, target / "detector.onnx")
        return
    run = train(settings)
    export(run.mean, settings.out / "detector.onnx")
    print(json.dumps({"step": run.step, "elapsed_s": run.elapsed_s}))


if __name__ == "__main__":
    main()
