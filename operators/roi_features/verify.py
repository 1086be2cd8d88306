"""Score how well an encoder verifies detections: `python -m operators.roi_features.verify --help`.

The detector reports everything down to a low score in the contexts of labelled stills; the encoder
sees each detection at full resolution and gives the probability that it is of its class. A person
is right where a person of that class is (IoU 0.3), a ball where its centre is at most 12 px away.
Detections of a class whose objects are not marked in a still are left out.

`--calibrate FILE` fits a temperature and a bias for each class on these detections, such that the
probabilities are true shares where as many detections are right as wrong, and writes the encoder
with them. How many are right depends on the detector's threshold (of a hundred weak balls one), so
the reader multiplies the odds with those of its own: odds = prior odds x p / (1 - p).
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax
from scipy.stats import rankdata

from drivers.source import Annotations
from operators.roi_features.data import whole
from operators.roi_features.roi_features import Encoder, RoiEncoderSettings
from operators.roi_features.stills import detected, truth_of
from operators.training.command_line import in_a_sentence
from operators.training.progress import each_of
from operators.training.splits import DEVELOPMENT, TEST
from operators.training.stills import class_names, pictures_of
from pipeline.boxes import centres, iou
from pipeline.errors import DriverError, SettingsError
from pipeline.extras import need
from pipeline.messages import Detections
from pipeline.weights import weights_file
from pipeline.whole_file import try_beside, write_whole

SPLITS = {"test": TEST, "development": DEVELOPMENT}
SAME_IOU, SAME_PX = 0.3, 12.0
BINS = 10  # of probabilities, of equal width


@dataclass(frozen=True, kw_only=True, eq=False)
class Verified:
    """Detections, what the encoder says of them, and whether they are right."""

    logits: NDArray[np.float32]  # (n, k)
    kinds: NDArray[np.int64]  # (n,) reported class, index into the encoder's names
    right: NDArray[np.bool_]  # (n,)
    scores: NDArray[np.float32]  # (n,) of the detector


def verified(encoder: Encoder, paths: Sequence[Path], names: dict[int, str]) -> Verified:
    """Look at all detections in stills; raises `DriverError` for files that cannot be read."""
    parts = []
    looks = zip(paths, detected(paths), strict=True)
    for path, seen in each_of(looks, "verify", len(paths)):
        picture, truth = truth_of(path, names)
        told = [seen.names[label] for label in seen.labels]
        marked = np.array([name in truth.labels for name in told], np.bool_)
        rows = np.flatnonzero(marked & np.isin(told, encoder.names))
        _, logits = encoder(whole(picture), seen.boxes[rows])
        parts.append(
            Verified(
                logits=logits,
                kinds=np.array([encoder.names.index(told[row]) for row in rows], np.int64),
                right=right(seen, truth)[rows],
                scores=seen.scores[rows],
            )
        )
    return joined(parts)


def joined(parts: Sequence[Verified]) -> Verified:
    """Concatenate; raises `DriverError` where there is nothing."""
    if not any(len(part.right) for part in parts):
        raise DriverError("stills: expected detections of classes that are marked, got none")
    return Verified(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in Verified.__dataclass_fields__
        }
    )


def right(seen: Detections, truth: Annotations) -> NDArray[np.bool_]:
    """Which detections are where an object of their class is: (n,)."""
    found = np.zeros(len(seen.boxes), np.bool_)
    for label, name in enumerate(seen.names):
        own = seen.labels == label
        true = truth.boxes[[each == name for each in truth.labels]]
        if not own.any() or not len(true):
            continue
        if name == "ball":
            apart = centres(seen.boxes[own])[:, None] - centres(true)[None]
            found[own] = np.linalg.norm(apart, axis=2).min(1) <= SAME_PX
        else:
            found[own] = iou(seen.boxes[own], true).max(1) >= SAME_IOU
    return found


def probabilities(found: Verified, theta: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Return the probability of the reported class (n,), with a calibration if given."""
    logits = found.logits.astype(np.float64)
    if theta is not None:
        logits = logits * np.exp(theta[0]) + theta[1:]
    chosen = log_softmax(logits, axis=1)[np.arange(len(logits)), found.kinds]
    return np.asarray(np.exp(chosen))


def calibration(found: Verified) -> NDArray[np.float64]:
    """Fit (1 + k,): logarithm of the inverse temperature, and a bias for each class.

    Minimised is the cross-entropy of the event that a detection is of its class, with equal
    weights of the classes and of right and wrong ones; a weak prior keeps them near 0.
    """
    classes = np.unique(found.kinds)
    weight = np.zeros(len(found.kinds))
    for kind in classes:
        own = found.kinds == kind
        weight[own] = even(found.right[own])

    def cost(theta: NDArray[np.float64]) -> float:
        chance = np.clip(probabilities(found, theta), 1e-7, 1 - 1e-7)
        loss = -np.where(found.right, np.log(chance), np.log1p(-chance))
        return float((loss * weight).sum() / len(classes) + 1e-3 * (theta**2).sum())

    start = np.zeros(1 + found.logits.shape[1])
    return np.asarray(minimize(cost, start, method="L-BFGS-B").x)


def even(right: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return weights (n,) whose sum is 1, and 0.5 over the right ones, where there are both."""
    share = right.mean()
    weights = np.where(right, 0.5 / max(share, 1e-9), 0.5 / max(1 - share, 1e-9))
    return np.asarray(weights / weights.sum())


def figures(chance: NDArray[np.float64], right: NDArray[np.bool_]) -> dict[str, float]:
    """Figures of one class: detections and their share that is right, and of the verdicts.

    auc: chance that a right detection is rated above a wrong one. At a probability of 0.5:
    precision, recall. ece: expected calibration error over ten bins, and nll: cross-entropy, both
    with even weights of right and wrong ones.
    """
    taken, count, weight = chance >= 0.5, int(right.sum()), even(right)
    ranks = rankdata(chance)
    wrong = len(right) - count
    area = (ranks[right].sum() - count * (count + 1) / 2) / max(count * wrong, 1)
    place = np.minimum((chance * BINS).astype(int), BINS - 1)
    sums = [np.bincount(place, weight * values, BINS) for values in (chance, right.astype(float))]
    safe = np.clip(chance, 1e-7, 1 - 1e-7)
    return {
        "detections": len(right),
        "right": float(right.mean()),
        "auc": float(area) if count and wrong else float("nan"),
        "precision": float(right[taken].mean()) if taken.any() else 0.0,
        "recall": float(taken[right].mean()) if count else 0.0,
        "ece": float(np.abs(sums[0] - sums[1]).sum()),
        "nll": float(-(weight * np.where(right, np.log(safe), np.log1p(-safe))).sum()),
    }


def table(
    found: Verified, names: Sequence[str], theta: NDArray[np.float64] | None = None
) -> dict[str, dict[str, float]]:
    """Figures of each reported class, and of the detector's own scores for it."""
    chance = probabilities(found, theta)
    rows = {}
    for kind in np.unique(found.kinds).tolist():
        own = found.kinds == kind
        rows[names[kind]] = figures(chance[own], found.right[own])
        rows[f"{names[kind]}, the detector's score"] = figures(
            found.scores[own].astype(np.float64), found.right[own]
        )
    return rows


def write_calibrated(before: Path, after: Path, theta: NDArray[np.float64], on: str) -> None:
    """Write an encoder whose logits are scaled and shifted; `on` says by which data."""
    need("onnx", "train")
    import onnx
    from onnx import helper, numpy_helper

    model = onnx.load(str(before))
    if "classes" not in {each.name for each in model.graph.output}:
        raise SettingsError(f"{before}: expected an encoder with an output `classes`, got none")
    again = len(model.graph.node)  # a calibrated file may be calibrated again
    plain, scaled, gain, bias = (
        f"{name}_{again}" for name in ("classes_plain", "classes_scaled", "gain", "bias")
    )
    for node in model.graph.node:
        for place, name in enumerate(node.output):
            if name == "classes":
                node.output[place] = plain
    constants = {gain: np.exp(theta[:1]), bias: theta[1:]}
    model.graph.initializer.extend(
        numpy_helper.from_array(value.astype(np.float32), name) for name, value in constants.items()
    )
    model.graph.node.extend(
        [
            helper.make_node("Mul", [plain, gain], [scaled]),
            helper.make_node("Add", [scaled, bias], ["classes"]),
        ]
    )
    known = {each.key: each.value for each in model.metadata_props}
    helper.set_model_props(model, known | {"calibrated": on})
    onnx.checker.check_model(model)
    write_whole(after, model.SerializeToString())


def stills_of(folders: Iterable[Path], split: str) -> list[tuple[list[Path], dict[int, str]]]:
    """Return the stills of a split and the names of their classes, by folder."""
    found = []
    for folder in folders:
        paths = [p for p in pictures_of(folder) if p.name.startswith(SPLITS[split])]
        if paths:
            found.append((paths, class_names(folder / "data.yaml")))
    if not found:
        raise DriverError(f"stills: expected some of the {split} split, got none")
    return found


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--stills", type=Path, nargs="+", required=True, help="labelled stills")
    parser.add_argument("--weights", default="", help="a file or a name; unless given, the shipped")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--calibrate", type=Path, metavar="FILE", help="write a calibrated encoder")
    parser.add_argument("--least-px", type=float, default=RoiEncoderSettings.least_px)
    parser.add_argument("--json", type=Path, help="write the figures here")
    given = parser.parse_args(words)
    if given.calibrate and given.split == "test":
        parser.error("--calibrate: expected --split development; the test is to measure")
    settings = RoiEncoderSettings(weights=given.weights, least_px=given.least_px)
    encoder = Encoder(settings)
    if given.calibrate:
        try_beside(given.calibrate)
    parts = [verified(encoder, *some) for some in stills_of(given.stills, given.split)]
    found = joined(parts)
    rows = table(found, encoder.names)
    if given.calibrate:
        theta = calibration(found)
        rows |= {f"{k}, calibrated": v for k, v in table(found, encoder.names, theta).items()}
        shipped = weights_file(given.weights, {"": Path(__file__).with_name("roi_encoder.onnx")})
        write_calibrated(shipped, given.calibrate, theta, "detections in stills: development split")
        print(f"gain {np.exp(theta[0]):.3f}, bias {np.round(theta[1:], 3).tolist()}")
    for name, row in rows.items():
        print(name, *(f"{figure} {value:.3f}" for figure, value in row.items()))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
