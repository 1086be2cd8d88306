"""Encode texts as network inputs: Tracks, features and looks -> arrays.

As `tokens.py` has them for tracking, and besides: whether and how often a text was shown at full
resolution, what the reader said of it, and the chance of reading it. A text has no class. A rule
says what each window promises (gain.py); the network corrects it. The last candidate is no
text but a search of the field, as the detector misses most texts in the context.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import PLACE
from operators.policy.looks import Looks
from operators.policy.readability import chances, heights
from operators.policy.reading.gain import SEARCH, foreseen, promised
from operators.policy.reading.windows import around
from operators.policy.search import search
from operators.policy.tokens import MOST_OBJECTS, Array, encode_boxes
from pipeline import Geometry, Tracks
from pipeline.boxes import centres, from_centres

PARTS = ("roi", "global", "motion", "feedback")  # parts that an ablation may omit
LOOKS = 9  # numbers of one text beside its boxes
FEEDBACK = (5, 6)  # those that the reader says
CONDITION = 9
DEAF = 2.0  # as a score that is sure: no reading is
SHARE_READ = 7  # the number of the condition that the reader says
LONG = 32  # frames: an older look makes no difference


@dataclass(frozen=True, kw_only=True, eq=False)
class Texts:
    """N candidates of one moment; the last one is the search. Zeros mean not seen."""

    ids: NDArray[np.int32]  # (N,) track ids, PLACE for the search
    roi: Array  # (N, To, D) features of the ROI encoder, where the ROI showed the text
    context: Array  # (N, To, C) features of the detector's map
    boxes: Array  # (N, To, 5) encoded boxes and whether seen
    predicted: Array  # (N, Tp, 4) encoded boxes
    looks: Array  # (N, LOOKS)
    rule: Array  # (N, Tp) what its window promises by the rule
    path: Array  # (N, Tp, 4) the windows that show it, sensor pixels


ENCODED = ("roi", "context", "boxes", "predicted", "looks", "rule")


def encode_texts(tracks: Tracks, looks: Looks, roi: Array, *, sure: float, delay: int = 0) -> Texts:
    """Return the tracks as candidates, best first by score if too many, and the search.

    The tracks are the first rows of `looks`; `roi` is (n, To, D).
    """
    count, geometry = len(tracks.ids), tracks.header.geometry
    rows = np.arange(count)
    if count > MOST_OBJECTS - 1:
        rows = np.sort(np.argsort(-tracks.scores, kind="stable")[: MOST_OBJECTS - 1])
    observed, horizon = tracks.boxes.shape[1], tracks.predicted.shape[1]
    first = tracks.header.seq + 1
    places = search(geometry, None, np.arange(first, first + horizon))[None]
    ahead = tracks.predicted[rows]
    chance = foreseen(ahead, geometry)
    alone = promised(
        looks, rows, chance[:, delay : delay + 1], np.eye(len(rows), dtype=np.bool_),
        first_seq=first, sure=sure, delay=0,
    )[:, 0]  # fmt: skip
    middles, shows = around(ahead[:, delay], alone, geometry)
    rule = promised(looks, rows, chance, shows, first_seq=first, sure=sure, delay=delay)
    both = np.concatenate([ahead, places])
    past = np.concatenate([tracks.boxes[rows], np.repeat(places[:, :1], observed, 1)])
    seen = np.zeros((len(both), observed, 1), np.float32)
    seen[:-1, :, 0] = tracks.visible[rows]

    def searched(values: Array) -> Array:
        return np.concatenate([values, np.zeros((1, *values.shape[1:]), np.float32)])

    return Texts(
        ids=np.append(tracks.ids[rows], np.int32(PLACE)),
        roi=searched(roi[rows]),
        context=searched(tracks.features[rows]),
        boxes=np.concatenate([encode_boxes(past, geometry), seen], -1),
        predicted=encode_boxes(both, geometry),
        looks=encode_looks(looks, rows, both, tracks.header.seq, sure),
        rule=np.concatenate([rule, np.full((1, horizon), SEARCH, np.float32)]),
        path=np.concatenate([aimed(ahead, middles - centres(ahead[:, delay]), geometry), places]),
    )


def aimed(predicted: Array, offset: Array, geometry: Geometry) -> Array:
    """Return paths of windows (n, Tp, 4) at an offset (n, 2) from boxes (n, Tp, 4).

    Windows are placed at the first step that counts; neighbours move alike after it.
    """
    size = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    centre = centres(predicted) + offset[:, None]
    return from_centres(centre, np.broadcast_to(size, centre.shape))


def encode_looks(looks: Looks, rows: NDArray[np.intp], path: Array, seq: int, sure: float) -> Array:
    """Return what was shown and read of texts `rows`, and a last row of the search: (N, LOOKS)."""
    encoded = np.zeros((len(rows) + 1, LOOKS), np.float32)
    shown, read = looks.shown[rows], looks.read[rows]
    chance = chances(heights(path[:-1]))  # (n, Tp)
    encoded[:-1, 0] = shown > 0
    encoded[:-1, 1] = np.log1p(shown) / 3
    encoded[:-1, 2] = np.where(shown > 0, np.clip((seq - looks.shown_seq[rows]) / LONG, 0, 1), 1)
    encoded[:-1, 3] = looks.tried[rows]
    encoded[:-1, 4] = np.maximum(chance[:, -1] - looks.tried[rows], 0)
    encoded[:-1, 5], encoded[:-1, 6] = read, read >= sure
    encoded[:-1, 7] = chance[:, 0]
    encoded[-1, 8] = 1
    return encoded


def encode_scene(tracks: Tracks, looks: Looks, window: Array, *, sure: float, delay: int) -> Array:
    """Return the condition (CONDITION,): this frame's window (4,), its size, counts, the delay."""
    geometry, count = tracks.header.geometry, len(tracks.ids)
    field = (max(geometry.width_px, 1), max(geometry.height_px, 1))
    encoded = np.zeros(CONDITION, np.float32)
    if window.any():
        encoded[:4] = encode_boxes(window, geometry)
    encoded[4:] = (
        geometry.roi_width_px / field[0],
        geometry.roi_height_px / field[1],
        count / MOST_OBJECTS,
        (looks.read[:count] >= sure).mean() if count else 0,
        delay / tracks.predicted.shape[1],
    )
    return encoded


def batched(
    moments: Sequence[Texts], conditions: Sequence[Array]
) -> dict[str, NDArray[np.generic]]:
    """The network's inputs for B moments, padded to the longest; `mask` (B, N): what is real."""
    most = max(len(moment.ids) for moment in moments)
    inputs: dict[str, NDArray[np.generic]] = {
        "condition": np.stack(conditions),
        "mask": np.arange(most) < np.array([len(m.ids) for m in moments])[:, None],
    }
    for name in ENCODED:
        first: Array = getattr(moments[0], name)
        padded = np.zeros((len(moments), most, *first.shape[1:]), np.float32)
        for row, moment in enumerate(moments):
            padded[row, : len(moment.ids)] = getattr(moment, name)
        inputs[name] = padded
    return inputs
