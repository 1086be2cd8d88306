"""Run one start of the tracker for a limited number of frames, on what a strategy reads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.tracking.camera import Camera
from bench.tracking.consumer import Box, Consumer
from bench.tracking.cue import Cue
from bench.tracking.replaced import Replaced
from bench.tracking.roi_path import RecordedRoiPath, RoiPath
from bench.tracking.stages import Stages
from bench.tracking.targets import Target
from drivers.commands import Window
from pipeline.boxes import centres, covered, iou
from pipeline.messages import Tracks


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The protocol of an episode."""

    longest: int = 64  # frames after the start
    delay: int = 0  # frames by which a plan comes late
    replan: int = 1  # Ta
    prediction: bool = True  # False: predicted boxes stay where they are
    context: bool = True  # False: the tracker sees the ROI alone
    aimed: bool = True  # the first ROI is on the target; False: in the middle
    local: bool = False  # the tracker's state is in pixels of the ROI and moves with it
    cue: bool = False  # the tracker gets a scanpath; False: none, and it never drops its object
    cue_delay: int = 0  # frames by which the cue comes late, the same for every strategy
    to_end: bool = False  # one start, followed to the end of the clip

    def last(self, start: int, frames: int) -> int:
        """Return the last frame of an episode in a clip of so many frames."""
        return frames - 1 if self.to_end else min(start + self.longest, frames - 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The surroundings of an episode: a sensor over a clip, the graph's stages, parts replaced."""

    camera: Camera
    stages: Stages
    tracks: Mapping[int, Tracks] = field(default_factory=dict)  # by frame, if it plans by them
    cue: Cue | None = None  # what the tracker hears
    rules: Rules
    replaced: Replaced = field(default_factory=Replaced)


@dataclass(kw_only=True, eq=False)
class Outcome:
    """The result of one start, for each of the n frames after the tracker was initialised."""

    start: int
    first: int = 0  # the frame of row 0
    iou: list[float] = field(default_factory=list)  # NaN where the target is not in the truth
    kept: list[bool] = field(default_factory=list)  # whether the strategy exposed this frame
    # distance of the centres, NaN as of `iou`, infinite without an answer
    away_px: list[float] = field(default_factory=list)
    # share of the target's box inside the ROI; NaN without ROI or truth
    shown: list[float] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)
    read_px: int = 0  # as the sensor counts them
    full_px: int = 0  # at full resolution, in the same time


def exposures(camera: Camera, start: int, last: int) -> list[int]:
    """Return the frames `start` to `last` in which an exposure ends."""
    how = camera.how.sampling
    found = list(range(start, last + 1, how.interval))
    if how.averaged:  # an exposure has the number of its last frame
        found = [end for frame in found if (end := frame + how.interval - 1) <= last]
    return found


def run(loop: Loop, target: Target, start: int, looked: Sequence[Window] = ()) -> Outcome:
    """Initialise the tracker from the truth in frame `start` and follow.

    `looked`: the ROI of each exposure, if known from an earlier run; it does not depend on what the
    tracker sees. Raises `RunError` if the number of pixels read is not that of the budget.
    """
    camera, rules, how = loop.camera, loop.rules, loop.camera.how
    step = how.sampling.interval
    last = rules.last(start, len(target.visible))
    exposed = exposures(camera, start, last)
    found = Outcome(start=start)
    if not exposed:
        return found
    found.first = exposed[0] + 1  # where the truth is given, nothing is found
    if not target.boxes[exposed[0]].any():
        return found
    path = RecordedRoiPath(looked, start) if looked else RoiPath(loop, target, start)
    window = path.window(exposed[0])
    consumer = Consumer(loop, target, exposed[0], window)
    camera.begin()
    box = consumer.box
    for frame in range(start, last + 1):
        kept = frame in exposed
        shown = float("nan")
        if kept:
            window = window if frame == exposed[0] else path.window(frame)
            context, roi = camera.expose(frame, frame - step + 1, window, consumer.near(frame))
            box = consumer.see(context, roi)
            if how.looks:
                shown = float(covered(target.boxes[frame][None], np.array(window, np.float32))[0])
                found.windows.append(window)
                box = loop.replaced.percept(box, target.boxes[frame], shown)
            path.after(frame, roi)
        if frame >= found.first:
            _score(found, target, frame, box, kept=kept, shown=shown)
    found.read_px, found.full_px = camera.counted()
    return found


def _score(
    found: Outcome, target: Target, frame: int, box: Box, *, kept: bool, shown: float
) -> None:
    """Add a frame; a box of zeros is no answer."""
    truth, known = target.boxes[frame], bool(target.visible[frame] > 0)
    nothing = float("nan")
    overlap = float(iou(box[None], truth[None])[0, 0]) if known else nothing
    away = float(np.linalg.norm(centres(box) - centres(truth))) if box.any() else float("inf")
    found.iou.append(overlap)
    found.away_px.append(away if known else nothing)
    found.kept.append(kept)
    found.shown.append(shown if known else nothing)
