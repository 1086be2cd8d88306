"""Set the number of objects in a running graph and measure their cost: `Crowd` and `Witness`.

`crowd.yaml` contains the two nodes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import Frame, Input, Operator, RoiFeatures, Scanpath, SettingsError, Tracks
from pipeline.boxes import centres, covered, from_centres, roi_window
from pipeline.graph.editing import rewired, with_nodes
from pipeline.graph.plan import Plan
from pipeline.messages import Header, altered

ADDED = Path(__file__).with_name("crowd.yaml")
FIRST_COPY = 1 << 24  # first id of copies, above all ids that a run assigns
WHOLE = 0.999  # a box with at least this share inside the ROI stays in place
SPREAD = (0.7549, 0.5698)  # multiples of this step, modulo 1, fill a square evenly
ROWS = ("labels", "scores", "boxes", "visible", "features", "predicted")  # of `Tracks`


@dataclass(frozen=True, kw_only=True)
class CrowdSettings:
    """The number of objects, and whether all are inside the ROI."""

    objects: int = 25
    together: bool = False

    def __post_init__(self) -> None:
        if self.objects < 1:
            raise SettingsError(f"objects: must be at least 1, got {self.objects}")


class Crowd(Operator[CrowdSettings, Tracks]):
    """Sends exactly `objects` tracks: real ones first, then copies; none without real ones."""

    tracks = Input(Tracks, keep="every")
    roi = Input(Frame, keep="latest")

    def on_tracks_roi(self, tracks: Tracks, roi: Frame) -> Tracks:
        """Add copies: at the places of their originals or, if `together`, inside the ROI."""
        if not len(tracks.ids):
            return tracks
        if not self.settings.together:
            return crowded(tracks, self.settings.objects)
        return gathered(tracks, self.settings.objects, shown(roi))


def crowded(tracks: Tracks, count: int) -> Tracks:
    """Return `count` tracks: the first of these, then copies of them in turn, with new ids."""
    true = min(count, len(tracks.ids))
    copies = FIRST_COPY + np.arange(count - true, dtype=np.int32)
    rows = np.arange(count) % len(tracks.ids)
    return altered(
        tracks,
        ids=np.concatenate([tracks.ids[:true], copies]),
        **{name: getattr(tracks, name)[rows] for name in ROWS},
    )


def gathered(tracks: Tracks, count: int, window: NDArray[np.float32]) -> Tracks:
    """Return `count` tracks inside a window (4,): those in it already, then moved copies."""
    there = covered(tracks.boxes[:, -1], window) >= WHOLE
    order = np.argsort(~there, kind="stable")
    named = {name: getattr(tracks, name)[order] for name in ("ids", *ROWS)}
    many = crowded(altered(tracks, **named), count)
    copies = np.arange(count) >= there.sum()
    ids = np.where(copies, FIRST_COPY + np.arange(count), many.ids).astype(np.int32)
    boxes = many.boxes[:, -1]
    sizes = np.minimum(boxes[:, 2:] - boxes[:, :2], window[2:] - window[:2])
    share = (np.arange(1, count + 1)[:, None] * SPREAD) % 1
    spots = window[:2] + sizes / 2 + share * (window[2:] - window[:2] - sizes)
    by = np.where(copies[:, None], spots - centres(boxes), 0).astype(np.float32)
    moved = {name: _moved(getattr(many, name), by, window) for name in ("boxes", "predicted")}
    return altered(many, ids=ids, **moved)


def _moved(
    boxes: NDArray[np.float32], by: NDArray[np.float32], window: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return boxes (n, t, 4) shifted by `by` (n, 2), none larger than the window."""
    sizes = np.minimum(boxes[..., 2:] - boxes[..., :2], window[2:] - window[:2])
    return from_centres(centres(boxes) + by[:, None], sizes)


def shown(roi: Frame) -> NDArray[np.float32]:
    """Return the window (4,) of an ROI frame, in sensor pixels; in the middle if it is empty."""
    field = roi.header.geometry
    middle = np.array([field.width_px / 2, field.height_px / 2], np.float32)
    window = roi.window if roi.pixels.size else roi_window(middle, field)
    return np.array(window, np.float32)


@dataclass(frozen=True, kw_only=True)
class WitnessSettings:
    """There is nothing to set."""


class Witness(Operator[WitnessSettings, None]):
    """Sends nothing; reports the number of objects and their processing times."""

    features = Input(RoiFeatures, keep="every", depth=64, join=False)
    scanpath = Input(Scanpath, keep="every", depth=64, join=False)

    def open(self) -> None:
        """Start with empty records."""
        self._encoder: dict[str, list[int]] = {"frames": [], "objects": [], "handler_ns": []}
        self._policy: dict[str, list[int]] = {"frames": [], "objects": [], "handler_ns": []}

    def on_features(self, features: RoiFeatures) -> None:
        """Record the encoder's objects and processing time."""
        _note(self._encoder, features.header, len(features.ids))

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Record the policy's objects and processing time."""
        _note(self._policy, scanpath.header, len(scanpath.ids))

    def summary(self) -> Mapping[str, Any]:
        """Return the records, with one entry per message."""
        return {"witness": {"encoder": self._encoder, "policy": self._policy}}


def _note(told: dict[str, list[int]], header: Header, objects: int) -> None:
    """Record a message; its sender's span is the last one of the trace."""
    told["frames"].append(header.seq)
    told["objects"].append(objects)
    told["handler_ns"].append(header.trace[-1].handler_ns)


def with_crowd(plan: Plan, settings: CrowdSettings) -> Plan:
    """Return a tracking graph with a `Crowd` on its tracks; raises `GraphError` for others."""
    found = with_nodes(plan, ADDED)
    for edge in plan.readers("association", "out"):
        found = rewired(found, f"{edge.end}=crowd")
    given = {"objects": settings.objects, "together": settings.together}
    nodes = (replace(n, settings=given) if n.name == "crowd" else n for n in found.nodes)
    return replace(found, name=f"{plan.name}-crowd", nodes=tuple(nodes))
