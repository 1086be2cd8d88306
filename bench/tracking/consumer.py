"""The graph's tracker in an episode, with or without a cue: exposures in, the object's box out.

With a cue the tracker is the one that ships: it gets a scanpath in every frame, drops an object
that it does not find or that the scanpath has elsewhere, and starts again on the scanpath's object.
The scanpath is the same for every strategy (`cue`). Two rules of the tracker are off in all rows,
which hold for a ROI that was aimed by the policy that it hears: `hidden_after`, by which it drops
what the ROI does not show, and `place_after`, by which it drops what the policy has lost. A third
one stays on: with a ROI the tracker starts again only where the ROI shows the object, without one
anywhere, so that `context` may start again where `centred` may not. Without a cue it gets no
scanpath and never drops its object.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.tracking.targets import Target
from drivers.commands import Window
from operators.tracker.following import TrackerState, proposed
from pipeline.messages import Frame, Percept, altered

if TYPE_CHECKING:
    from bench.tracking.episode import Loop

NEVER = 1_000_000  # frames: a tracker that has lost its target keeps searching at the last place
NOWHERE = np.zeros(4, np.float32)
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


class Consumer:
    """One start of the tracker; `box` is its last answer, zeros where it has none."""

    def __init__(self, loop: "Loop", target: Target, frame: int, window: Window) -> None:
        self._loop, self._cue = loop, loop.cue
        self._local = loop.rules.local and loop.camera.how.looks
        self.box: Box = target.boxes[frame]
        self._near: Box = self.box
        self._window = window
        given = self.box - corner(window) if self._local else self.box
        header = loop.camera.header(frame)
        if self._cue:  # as if a policy had shown it: a prompted tracker would not listen to one
            loop.stages.begin(header, "tracker", tracker={"hidden_after": NEVER, "place_after": 0})
            loop.stages.restore("tracker", TrackerState(box=given[None].astype(np.float32)))
        else:
            settings = {"init_box": tuple(float(v) for v in given), "lost_after": NEVER}
            loop.stages.begin(header, "tracker", tracker=settings)

    def near(self, frame: int) -> Box:
        """Return where the object is searched for: the last box, or without one the cue's."""
        shown = self._shown(frame)
        if self.box.any():
            self._near = self.box
        elif shown is not None:
            self._near = shown
        return self._near

    def see(self, context: Frame, roi: Frame) -> Box:
        """Return the box of the object in this exposure, zeros: the tracker has none."""
        loop, frame = self._loop, context.header.seq
        if loop.camera.how.looks and not loop.rules.context:
            context = loop.camera.nothing(frame)
        window = roi.window
        if self._local:
            left, top, right, bottom = window
            roi = altered(roi, window=(0, 0, right - left, bottom - top))
        path = self._cue.heard(frame, loop.rules.cue_delay) if self._cue else None
        if path is not None:
            loop.stages.call("tracker", scanpath=path)
        percept: Percept = loop.stages.call("tracker", context=context, roi=roi)
        shown = self._shown(frame)
        let_go = self.box.any() and not len(percept.boxes)
        if let_go and shown is not None and loop.camera.by_windows:
            # full resolution has the cue's object in the same exposure, though it was not made
            roi = loop.camera.around(frame, shown)
            percept = loop.stages.call("tracker", context=context, roi=roi)
        if len(percept.boxes):
            self.box = percept.boxes[0] + corner(window) if self._local else percept.boxes[0]
        elif self._cue:
            self.box = NOWHERE
        elif self._local:  # its answer is at a place of the ROI, wherever that is now
            self.box = self.box + corner(window) - corner(self._window)
        self._window = window
        return self.box

    def _shown(self, frame: int) -> Box | None:
        """Return the box that the cue shows in a frame."""
        if self._cue is None:
            return None
        shown = proposed(self._cue.heard(frame, self._loop.rules.cue_delay), frame)
        return None if shown is None else shown.box


def corner(window: Window) -> Box:
    """Return the left top corner of a window, twice: (4,)."""
    return np.array([*window[:2], *window[:2]], np.float32)
