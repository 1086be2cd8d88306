"""Where the ROI of an episode is, frame by frame, by strategy or from an earlier run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import PLANNED
from bench.tracking.targets import Target
from drivers.commands import Window
from pipeline.boxes import centres, roi_window
from pipeline.messages import Frame, RoiSchedule, Tracks, altered

if TYPE_CHECKING:
    from bench.tracking.episode import Loop


class RoiPath:
    """The ROI of each frame of an episode, by strategy."""

    def __init__(self, loop: "Loop", target: Target, start: int) -> None:
        self._loop, self._target, self._rules = loop, target, loop.rules
        how = loop.camera.how
        self._strategy, self._geometry = how.strategy, how.geometry
        self._planned = start - loop.rules.replan
        self._commanded: dict[int, Window] = {}
        field = np.array([0, 0, self._geometry.width_px, self._geometry.height_px])
        self._middle: Window = self._on(field)
        self._held = self._on(target.boxes[start]) if loop.rules.aimed else self._middle
        self._planned_by_graph = how.strategy in PLANNED
        if self._planned_by_graph:
            policy: dict[str, Any] = {"target": ""}
            if how.strategy == "foveated":
                policy["prompt_box"] = tuple(float(v) for v in target.boxes[start])
            header = loop.camera.header(start)
            loop.stages.begin(header, "roi_features", "policy", "dispatch", policy=policy)

    def window(self, frame: int) -> Window:
        """Return the window of a frame; call it in the order of frames."""
        if self._strategy == "centred":
            return self._middle
        if self._strategy == "oracle" and self._target.visible[frame] > 0:
            self._held = self._on(self._target.boxes[frame])
        self._held = self._commanded.pop(frame, self._held)
        return self._held

    def after(self, frame: int, roi: Frame) -> None:
        """Let the graph plan from a frame: as in the loop, tracks before features."""
        if not self._planned_by_graph:
            return
        stages, replaced = self._loop.stages, self._loop.replaced
        tracks = replaced.tracks(self._loop.tracks[frame], frame)
        if not self._rules.prediction:
            tracks = still(tracks)
        scanpath = stages.call("policy", tracks=tracks)
        scanpath = replaced.scanpath(scanpath, tracks, self._target, frame)
        schedule: RoiSchedule | None = stages.call("dispatch", scanpath=scanpath)
        looks = stages.looks(roi, tracks)
        stages.call("policy", features=looks)
        if schedule is None or frame - self._planned < self._rules.replan:
            return
        self._planned = frame
        for row, window in enumerate(schedule.windows[self._rules.delay :]):
            left, top, right, bottom = (int(side) for side in window)
            place = schedule.first_seq + self._rules.delay + row
            self._commanded[place] = (left, top, right, bottom)

    def _on(self, box: NDArray[np.float32]) -> Window:
        return roi_window(centres(np.asarray(box, np.float32)), self._geometry)


class RecordedRoiPath:
    """The ROI of each frame of an episode, from an earlier run."""

    def __init__(self, looked: Sequence[Window], start: int) -> None:
        self._looked, self._start = looked, start

    def window(self, frame: int) -> Window:
        """Return the window of the earlier run."""
        return self._looked[frame - self._start]

    def after(self, frame: int, roi: Frame) -> None:
        """Do nothing: the path is known."""


def still(tracks: Tracks) -> Tracks:
    """Return tracks whose predicted boxes stay where they are, to measure the use of prediction."""
    here = np.broadcast_to(tracks.boxes[:, -1:], tracks.predicted.shape).astype(np.float32)
    return altered(tracks, predicted=here)
