"""Quantise a detector to eight bits: `python -m operators.saliency.quantise --help`.

Weights and activations of the convolutions become whole numbers, scaled by what training pictures
give (static quantisation). What turns the last maps into boxes and scores stays in single
precision: boxes of hundreds of pixels and scores below one share a tensor there.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.saliency.crops import crop
from operators.saliency.description import described
from operators.saliency.detector import Detector
from operators.saliency.example import CONTEXT_PX, resized
from operators.saliency.letterbox import Letterbox
from operators.saliency.movement import in_motion
from operators.saliency.saliency import SaliencySettings
from operators.saliency.stills import stills
from operators.training.command_line import count, in_a_sentence
from operators.training.progress import each_of
from operators.training.splits import HELD_OUT
from pipeline.errors import SettingsError
from pipeline.extras import LateModule, need
from pipeline.inference import Network
from pipeline.whole_file import try_beside, write_whole

onnx: Any = LateModule("onnx")
quantization: Any = LateModule("onnxruntime.quantization")
prepared: Any = LateModule("onnxruntime.quantization.shape_inference")
Picture = tuple[NDArray[np.uint8], NDArray[np.int16] | None]  # and what changed in it
# give what is decoded; and the first ones, whose one or three channels are too few to gain by it
FLOATING = ("scores.1/Conv", "sides.1/Conv", "heat/Conv", "place/Conv", "stem.0.0/Conv")
BETWEEN = ("Add", "Concat", "MaxPool", "Relu", "Resize")  # between convolutions, in the network


class Pictures:
    """The network's inputs, one after the other, as a calibration asks for them."""

    def __init__(self, pictures: Iterator[Picture], detector: Detector) -> None:
        self._pictures = pictures
        self._box = Letterbox(
            *detector.size_px, scale=1 / 255, bgr=False, corner=False,
            difference=detector.reads_difference,
        )  # fmt: skip

    def get_next(self) -> dict[str, NDArray[np.float32]] | None:
        """The next input; none at the end."""
        picture = next(self._pictures, None)
        if picture is None:
            return None
        self._box.put(*picture)
        return {"images": self._box.tensor.copy()}


def quantised_nodes(path: Path) -> list[str]:
    """Names of the nodes that compute with whole numbers."""
    nodes = onnx.load(path).graph.node
    inside = ("/backbone/", "/neck/", "/ball/", "/moving/", "/heads")
    return [
        node.name
        for node in nodes
        if (node.op_type == "Conv" and not node.name.endswith(FLOATING) and "/net/" in node.name)
        or (node.op_type in BETWEEN and any(part in node.name for part in inside))
    ]


def quantise(path: Path, pictures: Iterator[Picture], out: Path) -> None:
    """Write the network at `path` with eight bits, its metadata kept; whole or not at all."""
    detector = Detector(SaliencySettings(weights=str(path), threads=1))
    with tempfile.TemporaryDirectory() as folder:
        ready, small = Path(folder) / "ready.onnx", Path(folder) / "small.onnx"
        prepared.quant_pre_process(path, ready, skip_symbolic_shape=True)
        quantization.quantize_static(
            ready,
            small,
            Pictures(pictures, detector),
            quant_format=quantization.QuantFormat.QDQ,
            per_channel=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
            nodes_to_quantize=quantised_nodes(ready),
            calibrate_method=quantization.CalibrationMethod.MinMax,
        )
        model = onnx.load(small)
    onnx.helper.set_model_props(model, dict(detector.network.metadata))
    write_whole(out, model.SerializeToString())


def training_pictures(folder: Path, most: int, *, roi: bool = False) -> Iterator[Picture]:
    """Well-spaced stills that a training sees, each with a frame before it as a context has it.

    With `roi` a part of each at full resolution, as a ROI shows it.
    """
    found = stills(folder, without=HELD_OUT)
    files = found.files[:: max(1, len(found.files) // most)][:most]
    for number, file in enumerate(files):
        still = found.example(file)
        if roi:
            yield crop(still, np.random.default_rng(number), CONTEXT_PX, scale=1.0).picture, None
            continue
        item = in_motion(resized(still, CONTEXT_PX), np.random.default_rng(number))
        changed = item.difference
        yield still.picture, None if changed is None else np.rint(changed).astype(np.int16)


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--stills", type=Path, required=True, help="labelled, to calibrate on")
    parser.add_argument("--pictures", type=count, default=64)
    parser.add_argument("--roi", action="store_true", help="calibrate on what a ROI shows")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(words)
    need("onnx", "quantise")
    metadata = Network(given.weights, threads=1).metadata
    if described(given.weights, metadata).difference and given.roi:  # refused in a sentence
        raise SettingsError(
            f"{given.weights}: reads what changed, which a ROI does not show (--roi)"
        )
    try_beside(given.out)
    seen = each_of(training_pictures(given.stills, given.pictures, roi=given.roi), "calibrate")
    quantise(given.weights, iter(seen), given.out)
    print(json.dumps({"bytes": given.out.stat().st_size}))


if __name__ == "__main__":
    main()
