"""Train the detector of text: `python -m operators.saliency.text.train --help`.

This module defines the options; the training itself, which needs torch, is in `training_run.py`.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from operators.saliency.text.settings import TextTrainSettings
from operators.training.command_line import GOES_ON, add_numbers, in_a_sentence
from operators.training.ranges import DEVICES
from pipeline.extras import need


def asked(words: Sequence[str] | None) -> tuple[TextTrainSettings, Path | None]:
    """Parse the command line: the settings, and the file to export to instead of training."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, required=True, help="drawn pictures, kept for later")
    parser.add_argument("--stills", type=Path, help="photographs (.jpg) to draw upon")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint, log and text.onnx")
    parser.add_argument("--export", type=Path, help="write this file, train nothing")
    parser.add_argument("--init", type=Path, help="checkpoint or detector.onnx to begin with")
    parser.add_argument("--compiled", action="store_true", help="compile first: needs g++")
    parser.add_argument("--device", default="auto", help=DEVICES)
    add_numbers(parser, TextTrainSettings)
    given = vars(parser.parse_args(words))
    target = given.pop("export")
    return TextTrainSettings(**given), target


@in_a_sentence(GOES_ON)
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    settings, target = asked(words)
    need("torch", "train")
    from operators.saliency.text.model import TextNet
    from operators.saliency.text.training_run import export, train, trained_on
    from operators.training import checkpoint

    if target is not None:
        net = TextNet()
        checkpoint.take(checkpoint.path_in(settings.out), {"mean": net})
        export(net, target, trained_on(settings))
        return
    run = train(settings)
    export(run.mean, settings.out / "text.onnx", trained_on(settings))
    print(json.dumps({"step": run.step, "elapsed_s": run.elapsed_s}))


if __name__ == "__main__":
    main()
