"""Where to look for what nobody has seen: where most people are, or the whole field by windows."""

import numpy as np
from numpy.typing import NDArray

from operators.policy.carrier import can_carry
from operators.policy.target import TargetSpec
from pipeline import Geometry, Tracks
from pipeline.boxes import centres, from_centres

DWELL = 2  # frames per window: enough for a consumer to see it, short enough to be quick


def search(
    geometry: Geometry, start: NDArray[np.float32] | None, frames: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return the search windows `frames` (t,) after its start: boxes of the ROI's size (t, 4).

    The windows tile the field and are visited cyclically, in the order of their distance from
    `start` (x, y) or from the middle.
    """
    places = tiles(geometry)
    middle = np.array([geometry.width_px, geometry.height_px], np.float32) / 2
    away = np.linalg.norm(places - (middle if start is None else start), axis=1)
    order = np.argsort(away, kind="stable")
    visited = places[order[frames // DWELL % len(order)]]
    size = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    return from_centres(visited, np.broadcast_to(size, visited.shape))


def tiles(geometry: Geometry) -> NDArray[np.float32]:
    """Centres of the fewest ROI windows that cover the field, evenly spread: (n, 2)."""
    sides = (
        (geometry.width_px, geometry.roi_width_px),
        (geometry.height_px, geometry.roi_height_px),
    )
    counts = [max(-(-whole // max(part, 1)), 1) for whole, part in sides]
    x, y = ((np.arange(n) + 0.5) * whole / n for n, (whole, _) in zip(counts, sides, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float32)


def busiest(tracks: Tracks, spec: TargetSpec, target: str) -> NDArray[np.float32] | None:
    """Return the person (4,) around whom a window shows most people that may have the target.

    For what people handle, asked for by its class: a ball is where they are. None for one object
    that was asked for by id or box, for people themselves, and where nobody is in view.
    """
    rows = np.flatnonzero(can_carry(tracks, spec.carriers, target) & tracks.visible[:, -1])
    if spec.one or not target or not len(rows):
        return None
    boxes, geometry = tracks.boxes[rows, -1], tracks.header.geometry
    half = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32) / 2
    middles = centres(boxes)
    inside = (np.abs(middles[:, None] - middles[None]) < half).all(2)
    return np.asarray(boxes[int(inside.sum(1).argmax())], np.float32)
