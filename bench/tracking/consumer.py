"""The graph's tracker in an episode, with or without a cue: exposures in, the object's box out.

With a cue the tracker gets a scanpath in every frame, as in the graph. It starts on an object of
that scanpath, drops one that it does not find or that the scanpath has elsewhere, and starts again.
The scanpath is made from what the row's own pictures show (`sight`): for a foveated row by the
policy that plans its ROI, for the others by the graph's, so that rows with a cue are not
comparable. Without a cue the tracker gets no scanpath and never drops its object.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.tracking.roi_path import RecordedRoiPath, RoiPath, still
from bench.tracking.stages import CUE
from bench.tracking.targets import Target
from drivers.commands import Window
from operators.tracker.following import TrackerState
from pipeline.messages import Frame, Percept, Scanpath, altered

if TYPE_CHECKING:
    from bench.tracking.episode import Loop

NEVER = 1_000_000  # frames: a tracker that has lost its target keeps searching at the last place
NOWHERE = np.zeros(4, np.float32)
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


class Consumer:
    """One start of the tracker; `box` is its last answer, zeros where it has none."""

    def __init__(self, loop: "Loop", target: Target, frame: int, window: Window) -> None:
        self._loop, self._target = loop, target
        how = loop.camera.how
        self._local = loop.rules.local and how.looks
        self._cued = loop.rules.cue
        self._own_policy = how.strategy == "foveated"
        self._scanpath: Scanpath | None = None
        self.box: Box = target.boxes[frame]
        self._near: Box = self.box
        self._window = window
        given = self.box - corner(window) if self._local else self.box
        header = loop.camera.header(frame)
        if self._cued:  # as if a policy had shown it: a prompted tracker would not listen to one
            loop.stages.begin(header, "tracker")
            loop.stages.restore("tracker", TrackerState(box=given[None].astype(np.float32)))
        else:
            settings = {"init_box": tuple(float(v) for v in given), "lost_after": NEVER}
            loop.stages.begin(header, "tracker", tracker=settings)
        if self._cued and not self._own_policy:
            prompt = {"target": "", "prompt_box": tuple(float(v) for v in target.boxes[frame])}
            loop.stages.begin(header, "roi_features", CUE, cue=prompt)

    def near(self, frame: int) -> Box:
        """Return where the object is searched for: the last box, or without one the cue's."""
        path = self._scanpath
        if self.box.any():
            self._near = self.box
        elif path is not None and 0 <= frame - path.first_seq < len(path.boxes):
            self._near = path.boxes[frame - path.first_seq]
        return self._near

    def see(self, context: Frame, roi: Frame) -> Box:
        """Return the box of the object in this exposure, zeros: the tracker has none."""
        stages = self._loop.stages
        if self._loop.camera.how.looks and not self._loop.rules.context:
            context = self._loop.camera.nothing(context.header.seq)
        window = roi.window
        if self._local:
            left, top, right, bottom = window
            roi = altered(roi, window=(0, 0, right - left, bottom - top))
        if self._scanpath is not None:
            stages.call("tracker", scanpath=self._scanpath)
        percept: Percept = stages.call("tracker", context=context, roi=roi)
        if len(percept.boxes):
            self.box = percept.boxes[0] + corner(window) if self._local else percept.boxes[0]
        elif self._cued:
            self.box = NOWHERE
        elif self._local:  # its answer is at a place of the ROI, wherever that is now
            self.box = self.box + corner(window) - corner(self._window)
        self._window = window
        return self.box

    def hear(self, frame: int, context: Frame, roi: Frame, path: RoiPath | RecordedRoiPath) -> None:
        """Take the cue for the next exposures, from what this one showed."""
        if not self._cued:
            return
        if self._own_policy:
            self._scanpath = path.scanpath
            return
        loop = self._loop
        tracks = loop.replaced.tracks(loop.tracks[frame], frame)
        if not loop.rules.prediction:
            tracks = still(tracks)
        self._scanpath = loop.stages.call(CUE, tracks=tracks)
        seen = roi if loop.camera.how.looks or loop.camera.by_windows else context
        looks = loop.stages.call("roi_features", roi=seen, tracks=tracks)
        loop.stages.call(CUE, features=looks)


def corner(window: Window) -> Box:
    """Return the left top corner of a window, twice: (4,)."""
    return np.array([*window[:2], *window[:2]], np.float32)
