"""One start of the tracker: followed for at most so many frames through what a strategy reads."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.replaced import Replaced
from bench.tracking.stages import Camera, Stages
from bench.tracking.targets import Target
from drivers.simulated.readout import Window
from pipeline.boxes import centres, covered, iou, roi_window
from pipeline.messages import Frame, Percept, RoiSchedule, Tracks, altered

NEVER = 1_000_000  # the frozen tracker is not helped: lost, it keeps looking where it was


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The protocol of an episode."""

    longest: int = 64  # frames after the start
    delay: int = 0  # frames by which a plan comes late
    replan: int = 1  # Ta
    prediction: bool = True  # False: boxes are foreseen where they are
    context: bool = True  # False: the tracker sees the ROI alone
    aimed: bool = True  # the first ROI is on the target; False: in the middle


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What became of one start, frame by frame after it: n frames."""

    start: int
    iou: list[float]  # NaN where the truth does not know the target
    kept: list[bool]  # whether the strategy exposed this frame
    shown: list[float]  # share of the target's box inside the ROI; NaN without ROI or truth
    windows: list[Window] = field(default_factory=list)


def run(
    camera: Camera,
    stages: Stages,
    tracks: Sequence[Tracks],
    target: Target,
    start: int,
    rules: Rules,
    replaced: Replaced,
    looked: Sequence[Window] = (),
) -> Outcome:
    """Initialise the tracker from the truth in frame `start` and follow.

    `looked`: where the ROI was in each exposure, when that is known: it does not depend on what the
    tracker sees.
    """
    how = camera.how
    step = how.sampling.interval
    last = min(start + rules.longest, len(target.visible) - 1)
    exposed = list(range(start, last + 1, step))
    if how.sampling.averaged:  # an exposure is told by its last frame
        exposed = [frame + step - 1 for frame in exposed if frame + step - 1 <= last]
    found = Outcome(start=start, iou=[], kept=[], shown=[])
    if not exposed:
        return found
    gaze: Gaze | Repeated = Repeated(looked, start)
    if not looked:
        gaze = Gaze(camera, stages, tracks, target, start, rules, replaced)
    first = target.boxes[exposed[0]]
    if not first.any():
        return found
    stages.begin(
        camera.header(start),
        "tracker",
        tracker={"init_box": tuple(float(v) for v in first), "lost_after": NEVER},
    )
    box = first
    for frame in range(start, last + 1):
        kept = frame in exposed
        shown = float("nan")
        if kept:
            camera.count()
            window = gaze.window(frame)
            roi = camera.roi(frame, window)
            context = camera.nothing(frame)
            if rules.context or not how.looks:
                context = camera.context(frame, frame - step + 1)
            percept: Percept = stages.tell("tracker", context=context, roi=roi)
            box = percept.boxes[0]
            if how.looks:
                shown = float(covered(target.boxes[frame][None], np.array(window, np.float32))[0])
                found.windows.append(window)
                box = replaced.percept(box, target.boxes[frame], shown)
            gaze.after(frame, roi)
        if frame > start:
            known = bool(target.visible[frame] > 0)
            overlap = iou(box[None], target.boxes[frame][None])[0, 0] if known else np.nan
            found.iou.append(float(overlap))
            found.kept.append(kept)
            found.shown.append(shown if known else float("nan"))
    return found


class Gaze:
    """Where the ROI is in each frame of an episode, by strategy."""

    def __init__(
        self,
        camera: Camera,
        stages: Stages,
        tracks: Sequence[Tracks],
        target: Target,
        start: int,
        rules: Rules,
        replaced: Replaced,
    ) -> None:
        self._camera, self._stages, self._tracks = camera, stages, tracks
        self._target, self._rules, self._replaced = target, rules, replaced
        self._start, self._planned = start, start - rules.replan
        self._commanded: dict[int, Window] = {}
        self._geometry = camera.how.geometry
        field = np.array([0, 0, self._geometry.width_px, self._geometry.height_px])
        self._middle: Window = self._on(field)
        self._held = self._on(target.boxes[start]) if rules.aimed else self._middle
        self._planned_by_graph = camera.how.strategy in ("foveated", "round_robin")
        if self._planned_by_graph:
            box = tuple(float(v) for v in target.boxes[start])
            tour = camera.how.strategy == "round_robin"
            wish = {"strategy": "round_robin", "target": ""} if tour else {}
            policy: dict[str, Any] = wish or {"prompt_box": box, "target": ""}
            stages.begin(camera.header(start), "roi_features", "policy", "dispatch", policy=policy)

    def window(self, frame: int) -> Window:
        """Where it looks in a frame; frames are asked for in order."""
        strategy = self._camera.how.strategy
        if strategy == "centred":
            return self._middle
        if strategy == "oracle" and self._target.visible[frame] > 0:
            self._held = self._on(self._target.boxes[frame])
        self._held = self._commanded.pop(frame, self._held)
        return self._held

    def after(self, frame: int, roi: Frame) -> None:
        """Let the graph plan, now that the frame is there: as in the loop, tracks before looks."""
        if not self._planned_by_graph:
            return
        tracks = self._replaced.tracks(self._tracks[frame], frame)
        if not self._rules.prediction:
            tracks = still(tracks)
        scanpath = self._stages.tell("policy", tracks=tracks)
        scanpath = self._replaced.scanpath(scanpath, tracks, self._target, frame)
        schedule: RoiSchedule | None = self._stages.tell("dispatch", scanpath=scanpath)
        looks = self._stages.tell("roi_features", roi=roi, tracks=tracks)
        self._stages.tell("policy", features=looks)
        if schedule is None or frame - self._planned < self._rules.replan:
            return
        self._planned = frame
        for row, window in enumerate(schedule.windows[self._rules.delay :]):
            left, top, right, bottom = (int(side) for side in window)
            place = schedule.first_seq + self._rules.delay + row
            self._commanded[place] = (left, top, right, bottom)

    def _on(self, box: NDArray[np.float32]) -> Window:
        return roi_window(centres(np.asarray(box, np.float32)), self._geometry)


class Repeated:
    """Where the ROI was in each frame of an episode that has been run before."""

    def __init__(self, looked: Sequence[Window], start: int) -> None:
        self._looked, self._start = looked, start

    def window(self, frame: int) -> Window:
        """As it was then."""
        return self._looked[frame - self._start]

    def after(self, frame: int, roi: Frame) -> None:
        """Nothing is planned."""


def still(tracks: Tracks) -> Tracks:
    """The same objects, foreseen where they are now: what prediction is worth is told by it."""
    here = np.broadcast_to(tracks.boxes[:, -1:], tracks.predicted.shape).astype(np.float32)
    return altered(tracks, predicted=here)
