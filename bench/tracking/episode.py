"""Run one start of the tracker for a limited number of frames, on what a strategy reads."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import PLANNED
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Camera, Stages
from bench.tracking.targets import Target
from drivers.commands import Window
from pipeline.boxes import centres, covered, iou, roi_window
from pipeline.messages import Frame, Percept, RoiSchedule, Tracks, altered

NEVER = 1_000_000  # frames: a tracker that has lost its target keeps searching at the last place


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The protocol of an episode."""

    longest: int = 64  # frames after the start
    delay: int = 0  # frames by which a plan comes late
    replan: int = 1  # Ta
    prediction: bool = True  # False: predicted boxes stay where they are
    context: bool = True  # False: the tracker sees the ROI alone
    aimed: bool = True  # the first ROI is on the target; False: in the middle


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The surroundings of an episode: a sensor over a clip, the graph's stages, parts replaced."""

    camera: Camera
    stages: Stages
    tracks: Sequence[Tracks] = ()  # of each frame, if the strategy plans by them
    rules: Rules
    replaced: Replaced = field(default_factory=Replaced)


@dataclass(kw_only=True, eq=False)
class Outcome:
    """The result of one start, for each of the n frames after the tracker was initialised."""

    start: int
    first: int = 0  # the frame of row 0
    iou: list[float] = field(default_factory=list)  # NaN where the target is not in the truth
    kept: list[bool] = field(default_factory=list)  # whether the strategy exposed this frame
    # share of the target's box inside the ROI; NaN without ROI or truth
    shown: list[float] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)
    read_px: int = 0  # as the sensor counts them
    full_px: int = 0  # at full resolution, in the same time


def run(loop: Loop, target: Target, start: int, looked: Sequence[Window] = ()) -> Outcome:
    """Initialise the tracker from the truth in frame `start` and follow.

    `looked`: the ROI of each exposure, if known from an earlier run; it does not depend on what the
    tracker sees. Raises `RunError` if the number of pixels read is not that of the budget.
    """
    camera, rules, how = loop.camera, loop.rules, loop.camera.how
    step = how.sampling.interval
    last = min(start + rules.longest, len(target.visible) - 1)
    exposed = list(range(start, last + 1, step))
    if how.sampling.averaged:  # an exposure has the number of its last frame
        exposed = [frame + step - 1 for frame in exposed if frame + step - 1 <= last]
    found = Outcome(start=start)
    if not exposed:
        return found
    found.first = exposed[0] + 1  # where the truth is given, nothing is found
    path = RecordedRoiPath(looked, start) if looked else RoiPath(loop, target, start)
    box = target.boxes[exposed[0]]
    if not box.any():
        return found
    loop.stages.begin(
        camera.header(start),
        "tracker",
        tracker={"init_box": tuple(float(v) for v in box), "lost_after": NEVER},
    )
    camera.begin()
    for frame in range(start, last + 1):
        kept = frame in exposed
        shown = float("nan")
        if kept:
            window = path.window(frame)
            context, roi = camera.expose(frame, frame - step + 1, window)
            if how.looks and not rules.context:
                context = camera.nothing(frame)
            percept: Percept = loop.stages.call("tracker", context=context, roi=roi)
            box = percept.boxes[0] if len(percept.boxes) else box
            if how.looks:
                shown = float(covered(target.boxes[frame][None], np.array(window, np.float32))[0])
                found.windows.append(window)
                box = loop.replaced.percept(box, target.boxes[frame], shown)
            path.after(frame, roi)
        if frame >= found.first:
            known = bool(target.visible[frame] > 0)
            overlap = iou(box[None], target.boxes[frame][None])[0, 0] if known else np.nan
            found.iou.append(float(overlap))
            found.kept.append(kept)
            found.shown.append(shown if known else float("nan"))
    found.read_px, found.full_px = camera.counted()
    return found


class RoiPath:
    """The ROI of each frame of an episode, by strategy."""

    def __init__(self, loop: Loop, target: Target, start: int) -> None:
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
        looks = stages.call("roi_features", roi=roi, tracks=tracks)
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
