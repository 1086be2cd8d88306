"""Encode objects as network inputs: Tracks and ROI features -> arrays.

Paper, section 3.5 and supplement "Scanpath Selection Policy": per object its appearance in the ROI
and in the context over the last To frames, its class, its boxes and when it was visible over them,
and its foreseen boxes over the next Tp.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import Geometry, Tracks

PARTS = ("roi", "global", "motion")  # parts that an ablation may omit
MOST_OBJECTS = 25
BOX = 4  # numbers of one encoded box
CLASSES = 8  # of a detector with their own column
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Objects:
    """N candidates of one moment. Zeros mean not seen."""

    ids: NDArray[np.int32]  # (N,) track ids, PLACE for the prompted place
    roi: Array  # (N, To, D) features of the ROI encoder, where the ROI showed the object
    context: Array  # (N, To, C) features of the detector's map
    boxes: Array  # (N, To, 5) encoded boxes and whether seen
    predicted: Array  # (N, Tp, 4) encoded boxes
    label: Array  # (N, CLASSES) 1 at its class
    place: Array  # (N,) 1: the prompted place, no track
    path: Array  # (N, Tp, 4) foreseen boxes, sensor pixels


def encode_boxes(boxes: Array, geometry: Geometry) -> Array:
    """Encode boxes for the network: (..., 4) sensor pixels -> (..., 4).

    Centre -1..1 across the field, and the logarithm of the sides' share of it, about -1..1.
    """
    field = np.array([max(geometry.width_px, 1), max(geometry.height_px, 1)], np.float32)
    centre = (boxes[..., :2] + boxes[..., 2:]) / field - 1
    sides = np.maximum(boxes[..., 2:] - boxes[..., :2], 1) / field
    return np.concatenate([centre, np.log(sides) / 3 + 1], -1).astype(np.float32)


def encode_labels(names: tuple[str, ...], wanted: Sequence[str]) -> Array:
    """1 at the place of each class in the detector's `names`: (n, CLASSES); 0 for others.

    >>> encode_labels(("ball", "player"), ["player", "dog"])[:, :3].tolist()
    [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    """
    encoded = np.zeros((len(wanted), CLASSES), np.float32)
    for row, name in enumerate(wanted):
        if name in names[:CLASSES]:
            encoded[row, names.index(name)] = 1
    return encoded


def encode_objects(tracks: Tracks, roi: Array) -> Objects:
    """All tracks as candidates, at most `MOST_OBJECTS` by score; `roi` is (n, To, D)."""
    rows: slice | NDArray[np.intp] = slice(None)  # copies nothing
    if len(tracks.ids) > MOST_OBJECTS:
        rows = np.sort(np.argsort(-tracks.scores, kind="stable")[:MOST_OBJECTS])
    geometry = tracks.header.geometry
    seen = tracks.visible[rows, :, None].astype(np.float32)
    return Objects(
        ids=tracks.ids[rows],
        roi=roi[rows],
        context=tracks.features[rows],
        boxes=np.concatenate([encode_boxes(tracks.boxes[rows], geometry), seen], -1),
        predicted=encode_boxes(tracks.predicted[rows], geometry),
        label=(tracks.labels[rows, None] == np.arange(CLASSES)).astype(np.float32),
        place=np.zeros(min(len(tracks.ids), MOST_OBJECTS), np.float32),
        path=tracks.predicted[rows],
    )


def joined(first: Objects, second: Objects) -> Objects:
    """Return both sets of candidates, without the last of the first beyond `MOST_OBJECTS`."""
    kept = slice(MOST_OBJECTS - len(second.ids))
    return Objects(
        **{
            name: np.concatenate([getattr(first, name)[kept], getattr(second, name)])
            for name in Objects.__dataclass_fields__
        }
    )


def without(candidates: Objects, refused: NDArray[np.bool_]) -> Objects:
    """Return the candidates that are not refused (N,); all if none would be left."""
    if refused.all() or not refused.any():
        return candidates
    return Objects(
        **{name: getattr(candidates, name)[~refused] for name in Objects.__dataclass_fields__}
    )


def batched(
    moments: Sequence[Objects], conditions: Sequence[Array]
) -> dict[str, NDArray[np.generic]]:
    """The network's inputs for B moments, padded to the longest; `mask` (B, N): what is real."""
    most = max(1, *(len(m.ids) for m in moments))
    first = moments[0]
    inputs: dict[str, NDArray[np.generic]] = {
        "condition": np.stack(conditions),
        "mask": np.zeros((len(moments), most), np.bool_),
    }
    shapes = {
        name: getattr(first, name).shape[1:]
        for name in ("roi", "context", "boxes", "predicted", "label", "place")
    }
    for name, shape in shapes.items():
        if len(moments) == 1 and len(first.ids) == most:  # the case of a running graph
            inputs[name] = getattr(first, name)[None]
            continue
        padded = np.zeros((len(moments), most, *shape), np.float32)
        for row, moment in enumerate(moments):
            padded[row, : len(moment.ids)] = getattr(moment, name)
        inputs[name] = padded
    for row, moment in enumerate(moments):
        inputs["mask"][row, : len(moment.ids)] = True
    return inputs
