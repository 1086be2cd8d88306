"""Give a new detector the features of an older one: `python -m operators.saliency.alignment`.

Association and the policy read 64 features of each object, and were trained on those of the
detector that was shipped then. A new detector's features mean the same in other coordinates, as far
as both networks look at the same things. A linear map between them is fitted on objects of training
pictures by least squares and written into the new network's file, behind its own features, which
its heads keep. It costs 0.01 GFLOP. The share of variance that it explains is told of pictures that
the fit did not see; with little of it, the policy is to be trained anew.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from operators.saliency.data import Rendered, rendered_in
from operators.saliency.detector import FEATURE_STRIDE_PX, SHIPPED, Detector
from operators.saliency.example import Example
from operators.saliency.roi_align import roi_align
from operators.saliency.saliency import SaliencySettings
from operators.training.command_line import count, in_a_sentence
from operators.training.progress import each_of
from pipeline.errors import WeightsError
from pipeline.whole_file import try_beside, write_whole

Array = NDArray[np.float32]
RIDGE = 1e-3  # of the mean variance of a feature
HELD_BACK = 5  # every fifth picture is kept for the share explained
OWN = "features_own"


def collected(
    new: Detector, old: Detector, examples: Iterable[Example]
) -> tuple[list[Array], list[Array]]:
    """Features of the objects of each picture, (n, C) by the new and by the old detector."""
    mine: list[Array] = []
    theirs: list[Array] = []
    for item in examples:
        kept = item.boxes[~item.ignored]
        if not len(kept):
            continue
        for detector, rows in ((new, mine), (old, theirs)):
            _, at, features = detector.look(item.picture)
            assert features is not None
            boxes = kept * np.float32(at.gain) + np.array([at.left_px, at.top_px] * 2, np.float32)
            rows.append(roi_align(features, boxes, stride_px=FEATURE_STRIDE_PX))
    return mine, theirs


def fitted(mine: Array, theirs: Array) -> tuple[Array, Array]:
    """Matrix (C, D) and offset (D,) that take (n, C) to (n, D) with the least squares."""
    middle, wanted = mine.mean(0), theirs.mean(0)
    x, y = (mine - middle).astype(np.float64), (theirs - wanted).astype(np.float64)
    gram = x.T @ x
    gram += np.eye(len(gram)) * RIDGE * np.trace(gram) / len(gram)
    matrix = np.linalg.solve(gram, x.T @ y).astype(np.float32)
    return matrix, (wanted - middle @ matrix).astype(np.float32)


def explained(mine: Array, theirs: Array, matrix: Array, offset: Array) -> float:
    """Share of the variance of (n, D) that the mapped (n, C) explain: 1 is all of it.

    Below 0 their mean would do better.
    """
    left = np.square(np.maximum(mine @ matrix + offset, 0) - theirs).sum()
    return float(1 - left / max(float(np.square(theirs - theirs.mean(0)).sum()), 1e-12))


def mapped(path: Path, matrix: Array, offset: Array, out: Path) -> None:
    """Write a network whose features go through a map; raises `WeightsError` if they do already."""
    model = onnx.load(path)
    graph = model.graph
    if any(OWN in node.output for node in graph.node):
        raise WeightsError(f"{path}: expected a detector as it was exported, got an aligned one")
    for node in graph.node:
        node.input[:] = [OWN if name == "features" else name for name in node.input]
        node.output[:] = [OWN if name == "features" else name for name in node.output]
    kernel = np.ascontiguousarray(matrix.T[:, :, None, None])
    graph.initializer.extend(
        [
            numpy_helper.from_array(kernel, "alignment.weight"),
            numpy_helper.from_array(offset, "alignment.bias"),
        ]
    )
    names = [OWN, "alignment.weight", "alignment.bias"]
    graph.node.append(helper.make_node("Conv", names, ["alignment.out"], name="alignment.map"))
    # the features that others know are never below zero
    graph.node.append(
        helper.make_node("Relu", ["alignment.out"], ["features"], name="alignment.relu")
    )
    onnx.checker.check_model(model)
    write_whole(out, model.SerializeToString())


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", type=Path, required=True, help="the new detector's")
    parser.add_argument("--like", type=Path, default=SHIPPED, help="those whose features to give")
    parser.add_argument("--data", type=Path, required=True, help="rendered scenes")
    parser.add_argument("--pictures", type=count, default=600)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(words)
    new, old = (Detector(SaliencySettings(weights=str(w))) for w in (given.weights, given.like))
    if not (new.channels and old.channels):
        raise WeightsError(f"{given.weights}: expected two detectors with features, got none")
    try_beside(given.out)
    scenes = Rendered(rendered_in(given.data), seed=0)
    rows = np.linspace(0, len(scenes) - 1, min(given.pictures, len(scenes))).astype(int)
    mine, theirs = collected(new, old, each_of((scenes.plain(int(k)) for k in rows), "look"))
    fit = [k for k in range(len(mine)) if k % HELD_BACK]
    matrix, offset = fitted(
        np.concatenate([mine[k] for k in fit]), np.concatenate([theirs[k] for k in fit])
    )
    rest = slice(0, None, HELD_BACK)
    told = explained(np.concatenate(mine[rest]), np.concatenate(theirs[rest]), matrix, offset)
    mapped(given.weights, matrix, offset, given.out)
    print(json.dumps({"objects": sum(map(len, mine)), "explained": round(told, 3)}))


if __name__ == "__main__":
    main()
