"""A plan: the object or position to look at in each of the next frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import Geometry, Scanpath, SettingsError, Tracks

PLACE = -1  # a choice that is no object
MOST_AHEAD = 1000  # frames of a plan: the paper's longest has 200


@dataclass(frozen=True, kw_only=True, eq=False)
class GazePlan:
    """One row per frame after the tracks' own."""

    choice: NDArray[np.int32]  # (Tp,), track id or PLACE
    boxes: NDArray[np.float32]  # (Tp, 4), sensor pixels
    # (Tp, n) per track; the rest to 1 belongs to a position. None: 1 for the chosen object
    probability: NDArray[np.float32] | None = None


def future(tracks: Tracks, row: int, horizon: int) -> NDArray[np.float32]:
    """Return the predicted boxes of object `row`: (Tp, 4), constant past the tracks' horizon."""
    path = tracks.predicted[row] if tracks.predicted.shape[1] else tracks.boxes[row, -1:]
    return path[np.minimum(np.arange(horizon), len(path) - 1)]


def follow(tracks: Tracks, row: int, horizon: int) -> GazePlan:
    """Return a plan that looks at one object."""
    choice = np.full(horizon, tracks.ids[row], np.int32)
    return GazePlan(choice=choice, boxes=future(tracks, row, horizon))


def stay(boxes: NDArray[np.float32], horizon: int) -> GazePlan:
    """Return a plan that looks at positions: one box (4,) for all frames, or (Tp, 4)."""
    places = np.broadcast_to(boxes, (horizon, 4)).astype(np.float32)
    return GazePlan(choice=np.full(horizon, PLACE, np.int32), boxes=places)


def no_proposal() -> GazePlan:
    """Return an empty plan: the previous one stays in effect."""
    return GazePlan(choice=np.zeros(0, np.int32), boxes=np.zeros((0, 4), np.float32))


def check_horizon(frames: int) -> None:
    """Raise `SettingsError` for an invalid number of planned frames."""
    if not 1 <= frames <= MOST_AHEAD:
        raise SettingsError(f"horizon: expected 1 to {MOST_AHEAD}, got {frames}")


def field_centre(geometry: Geometry) -> NDArray[np.float32]:
    """A box of the ROI's size in the middle of the field: (4,)."""
    middle = np.array([geometry.width_px, geometry.height_px], np.float32) / 2
    half = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32) / 2
    return np.concatenate([middle - half, middle + half])


def of_class(tracks: Tracks, name: str) -> NDArray[np.bool_]:
    """Return which tracks are of class `name`: (n,); all for "", none for an unknown name."""
    if not name:
        return np.ones(len(tracks.ids), np.bool_)
    label = tracks.names.index(name) if name in tracks.names else -1
    return np.asarray((tracks.labels == label) & (label >= 0), np.bool_)


def row_of(tracks: Tracks, object_id: int) -> int:
    """Return the row of an id, -1 when it is missing (or no object)."""
    rows = np.flatnonzero(tracks.ids == object_id)
    return int(rows[0]) if object_id != PLACE and len(rows) else -1


def scanpath(tracks: Tracks, plan: GazePlan) -> Scanpath:
    """The message."""
    probability = plan.probability
    if probability is None:
        probability = (plan.choice[:, None] == tracks.ids[None]).astype(np.float32)
    return Scanpath(
        header=tracks.header,
        ids=tracks.ids,
        probability=probability,
        choice=plan.choice,
        boxes=plan.boxes,
        first_seq=tracks.header.seq + 1,
    )
