"""The windows that a ROI may show next, and what is known of each: tracks in, arrays out.

Candidates are a window around each track, one between any two tracks that it can show together, and
those that tile the workplace, in which what the detector misses is found.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.acting.looked import NEVER, Looked, means
from pipeline import Geometry, Tracks
from pipeline.boxes import areas, centres, intersections

Array = NDArray[np.float32]
Region = tuple[float, float, float, float]  # xyxy, shares of the field

TRACK, PAIR, PLACE = range(3)
FACTS = 15  # of a candidate, beside its appearance
AGE = 6  # of the facts: how long ago the window was shown
MOST_TRACKS = 12  # the surest; 78 windows at most
MOST_PAIRS = 30
OLD = 200  # frames: a look so long ago makes no difference any more
SPEED_PX = 10.0  # per frame: about the fastest gripper


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """n windows of the ROI's size, aligned as the sensor addresses them."""

    windows: Array  # (n, 4) sensor pixels
    kinds: NDArray[np.int64]  # (n,)
    members: NDArray[np.int64]  # (n, 2) rows of tracks, -1: none


def candidates(tracks: Tracks, workplace: Region) -> Candidates:
    """Return the windows for the frame after the tracks'; there is always one."""
    geometry = tracks.header.geometry
    roi: Array = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    rows = np.sort(np.argsort(-tracks.scores, kind="stable")[:MOST_TRACKS])
    middle = centres(next_boxes(tracks))[rows]
    one, other = np.triu_indices(len(rows), 1)
    fits = np.flatnonzero((np.abs(middle[one] - middle[other]) < roi).all(1))[:MOST_PAIRS]
    one, other = one[fits], other[fits]
    places = tiles(workplace, geometry)
    at = np.concatenate([middle, (middle[one] + middle[other]) / 2, places]).astype(np.float32)
    kinds = np.repeat([TRACK, PAIR, PLACE], [len(rows), len(one), len(places)])
    none = np.full(len(places), -1)
    members = np.stack(
        [
            np.concatenate([rows, rows[one], none]),
            np.concatenate([rows, rows[other], none]),
        ],
        axis=1,
    )
    return Candidates(windows=aligned(at, geometry), kinds=kinds, members=members)


def tiles(workplace: Region, geometry: Geometry) -> Array:
    """Return the centres (n, 2) of the fewest windows that cover a part of the field."""
    lines = []
    for axis, (field, side) in enumerate(
        (
            (geometry.width_px, geometry.roi_width_px),
            (geometry.height_px, geometry.roi_height_px),
        )
    ):
        low, high = workplace[axis] * field, workplace[axis + 2] * field
        count = max(1, int(np.ceil((high - low) / max(side, 1) - 1e-6)))
        lines.append(np.linspace(low + side / 2, high - side / 2, count) if count > 1
                     else np.array([(low + high) / 2]))  # fmt: skip
    return np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2).astype(np.float32)


def in_turn(found: Candidates, seq: int) -> int:
    """Return the row of the place whose turn frame `seq` is."""
    places = np.flatnonzero(found.kinds == PLACE)
    return int(places[seq % len(places)])


def aligned(at: Array, geometry: Geometry) -> Array:
    """Return the windows (n, 4) of the ROI's size around centres (n, 2), inside the field."""
    roi = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    field = np.array([geometry.width_px, geometry.height_px], np.float32)
    corners = np.clip(np.rint(at - roi / 2), 0, np.maximum(field - roi, 0))
    corners -= corners % geometry.step_px
    return np.concatenate([corners, corners + roi], axis=1).astype(np.float32)


def next_boxes(tracks: Tracks) -> Array:
    """Return the boxes (n, 4) of the next frame."""
    return tracks.predicted[:, 0] if tracks.predicted.shape[1] else tracks.boxes[:, -1]


def facts(tracks: Tracks, looked: Looked, found: Candidates, seq: int) -> Array:
    """Return what is known of each window (n, FACTS), about -1 to 2; see the names below."""
    geometry, windows = tracks.header.geometry, found.windows
    field = np.array([geometry.width_px, geometry.height_px], np.float32)
    roi = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    unknown = (~looked.known).astype(np.float32)
    since = np.where(looked.shown_seq == NEVER, OLD, np.minimum(seq - looked.shown_seq, OLD))
    age = (np.log1p(np.maximum(since, 0)) / np.log1p(OLD)).astype(np.float32)
    boxes = next_boxes(tracks)
    speed = np.linalg.norm(centres(boxes) - centres(tracks.boxes[:, -1]), axis=1) / SPEED_PX
    inside = intersections(windows, boxes) / np.maximum(areas(boxes), 1e-9)  # (n, tracks)
    objects_unknown = means(unknown, boxes, geometry)
    objects_age = means(age, boxes, geometry)
    member, single = found.members[:, 0], found.kinds == TRACK
    size = np.zeros((len(windows), 2), np.float32)
    size[single] = (boxes[member[single], 2:] - boxes[member[single], :2]) / roi
    visible = np.zeros(len(windows), np.float32)
    visible[single] = tracks.visible[member[single], -1]
    columns = [
        *(2 * centres(windows) / field - 1).T,
        *(np.eye(3)[found.kinds]).T,
        means(unknown, windows, geometry),
        means(age, windows, geometry),
        inside @ objects_unknown / 2,
        inside @ objects_age / 2,
        inside.sum(1) / 2,
        inside @ tracks.scores / 2,
        inside @ np.minimum(speed, 3) / 2,
        *np.minimum(size, 3).T,
        visible,
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def appearance(tracks: Tracks, found: Candidates) -> Array:
    """Return the detector's features of each window's tracks (n, channels), their mean; 0: none."""
    newest = tracks.features[:, -1]
    out = np.zeros((len(found.windows), newest.shape[1]), np.float32)
    held = found.members[:, 0] >= 0
    if held.any():
        out[held] = (newest[found.members[held, 0]] + newest[found.members[held, 1]]) / 2
    return out
