"""Follow one object by a method, and drop it when the policy has chosen another.

A method (correlation, ViTTrack, MixFormerV2) finds an object again from frame to frame, but does
not notice when it drifts to another one. The scanpath reveals this: for every frame it contains the
policy's object and its predicted box. Both are compared in every frame, and only disagreement in
several consecutive frames counts, so that a single wrong scanpath has no effect. A scanpath that
shows a place, and no object, counts as well: what the policy has lost is dropped.

A ball in flight leaves within a frame what is searched around its last place. As long as the two
agree, a fast object is therefore searched where the policy foresees it.

Where a detector says what it finds in the ROI, an object that was lost is answered where such a
find has been likely for some frames (`finds`), until the policy shows one that can be followed.
"""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from operators.tracker.finds import FAR_PX, Finds, after, same
from operators.tracker.look import Streams
from pipeline import Detections, Frame, Scanpath
from pipeline.boxes import centres, covered, sizes

NOBODY = -1  # id of an object without a track
FAST = 0.5  # sizes in a frame, from which an object is searched where it is foreseen
SHOWN = 0.5  # share of a box inside the ROI from which the ROI shows it
REASONS = ("missed", "drift", "switch", "hidden", "place")  # to drop an object
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels
NONE = np.zeros((0, 4), np.float32)
Memory = tuple[NDArray[np.uint8] | NDArray[np.float32], ...]


class Method(Protocol):
    """A method to find one object in every frame."""

    patience_score: float  # a lower score means that the object is not found
    provider: str  # of its network; empty: it has none

    def start(self, streams: Streams, box: Box) -> None:
        """Initialise with the object in this box."""

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        """Return the object's box, given the previous one, and a confidence 0..1."""

    def aligned(self, box: Box, foreseen: Box) -> Box:
        """Return the box, corrected towards the predicted one if the method benefits."""

    def memory(self) -> Memory:
        """Return its state for another instance; empty before `start`."""

    def resume(self, memory: Memory) -> bool:
        """Take over another instance's memory; return False, unchanged, if it is invalid."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """When to drop an object, in consecutive frames."""

    lost_score: float  # below it the method has not found the object
    lost_after: int  # frames without finding it
    drift_after: int  # frames beside the object that the policy shows
    switch_after: int  # the same, where the policy shows another object than before
    hidden_after: int  # frames outside the ROI while the policy looks at a place
    place_after: int  # the same, whatever the ROI shows; 0: never
    found_for: int  # frames after its loss in which an object is answered where it is found


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackerState:
    """The state for a successor."""

    box: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    object_id: int = NOBODY  # the track that the policy calls it; NOBODY: the box was given
    prompted: bool = False  # the box was given: the policy's choice does not count
    begun: bool = False  # the method has seen the object
    missed_frames: int = 0  # in succession, in which the method did not find it
    apart_frames: int = 0  # in succession, in which the policy's object was elsewhere
    hidden_frames: int = 0  # in succession, in which the ROI did not show it
    place_frames: int = 0  # in succession, in which the policy looked at a place
    called: str = ""  # class that the detector in the ROI gave the object, or the one that was lost
    size_px: float = 0.0  # of that
    lost_frames: int = 0  # since that was lost
    lost_id: int = NOBODY  # what the policy called it
    finds: Finds = field(default_factory=Finds)
    memory: Memory = ()  # the method's own


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """The policy's choice in one frame: an object, or a position (`NOBODY`)."""

    object_id: int
    box: Box
    motion: float = 0.0  # foreseen until the next frame, in sizes; 0 at the end of a plan


class Following:
    """Follows one object at a time, given by a prompt or chosen by the policy."""

    def __init__(self, method: Method, rules: Rules) -> None:
        self.rules, self._method = rules, method
        self._finds = Finds()
        self.lost: dict[str, int] = dict.fromkeys(REASONS, 0)
        self.forget()

    @property
    def box(self) -> NDArray[np.float32]:
        """Where the object is believed to be: (1, 4), or (0, 4) without one."""
        return self._box

    @property
    def answer(self) -> NDArray[np.float32]:
        """The box, or where an object that was lost is found: (1, 4), or (0, 4) for nothing."""
        return self._box if len(self._box) else self._found

    @property
    def object_id(self) -> int:
        """The policy's id of the object, `NOBODY` where there is none."""
        return self._id

    def state(self) -> TrackerState:
        """Everything a successor needs."""
        return TrackerState(
            box=self._box,
            object_id=self._id,
            prompted=self._prompted,
            begun=self._begun,
            missed_frames=self._missed,
            apart_frames=self._apart,
            hidden_frames=self._hidden,
            place_frames=self._place,
            called=self._called,
            size_px=self._size_px,
            lost_frames=self._lost,
            lost_id=self._lost_id,
            finds=self._finds,
            memory=tuple(part.copy() for part in self._method.memory()) if self._begun else (),
        )

    def restore(self, state: TrackerState) -> None:
        """Go on where another instance stopped; one of another method learns the object anew."""
        self._box, self._id, self._prompted = state.box, state.object_id, state.prompted
        self._missed, self._apart = state.missed_frames, state.apart_frames
        self._hidden, self._place = state.hidden_frames, state.place_frames
        self._called, self._size_px, self._lost = state.called, state.size_px, state.lost_frames
        self._lost_id, self._finds, self._found = state.lost_id, state.finds, NONE
        self._begun = state.begun and self._method.resume(state.memory)

    def forget(self) -> None:
        """Drop the object."""
        self.restore(TrackerState())

    def take(self, box: Box) -> None:
        """Follow the object in this box from the next frame on, whatever the policy chooses."""
        self._begin(TrackerState(box=box[None].copy(), prompted=True))

    def see(self, seen: Detections) -> None:
        """Take what a detector finds in the ROI."""
        self._finds = after(self._finds, seen)

    def step(self, streams: Streams, shown: Proposal | None) -> float:
        """Process one frame; return the method's score, 1 at a start, 0 without an object.

        Of a lost object that a detector finds in the ROI, its rating.
        """
        score = 0.0
        if len(self._box) and self._begun:
            score = self._follow(streams, self._search_box(shown))
            self._compare(streams, shown)
            self._note_class(streams.roi.header.seq)
            self._let_go(shown)
        if not len(self._box) and shown and _startable(shown, streams.roi):
            self._begin(TrackerState(box=shown.box[None].copy(), object_id=shown.object_id))
        if not len(self._box):
            return self._find_again(streams, shown)
        if not self._begun:
            self._method.start(streams, self._box[0])
            self._begun, score = True, 1.0
        return score

    def _begin(self, state: TrackerState) -> None:
        """Change the object; what is found in the ROI does not depend on it."""
        self.restore(replace(state, finds=self._finds))

    def _note_class(self, seq: int) -> None:
        """Note what the detector calls the object, by which it is known when it is lost.

        Not while the tracker may be on something else.
        """
        if self._missed or self._apart or self._place or not self._finds.speak_of(seq):
            return
        if name := self._finds.name_at(self._box[0]):
            self._called, self._size_px = name, float(sizes(self._box)[0])

    def _find_again(self, streams: Streams, shown: Proposal | None) -> float:
        """Note where the lost object is found, and return how sure that is; 0 for nowhere."""
        self._found, self._lost = NONE, self._lost + 1
        other = shown is not None and shown.object_id not in (NOBODY, self._lost_id)
        self._apart = self._apart + 1 if other else 0
        if self._apart >= self.rules.switch_after:
            self._called = ""
        known = self._called and self._finds.speak_of(streams.roi.header.seq)
        if not known or self._lost > self.rules.found_for:
            return 0.0
        row = self._finds.best(self._called, self._size_px)
        windows = (streams.roi, *streams.further)
        if row < 0 or not any(shows(window, self._finds.boxes[row]) for window in windows):
            return 0.0
        self._found = self._finds.boxes[row : row + 1].copy()
        return float(self._finds.ratings[row])

    def _search_box(self, shown: Proposal | None) -> Box:
        """Return the box to search around: a fast object's where the policy foresees it.

        Its own where the two disagreed in the frame before: then one of them is on something else.
        """
        box: Box = self._box[0]
        if shown is None or shown.motion < FAST or self._apart:
            return box
        if shown.object_id != self._id or self._id == NOBODY:
            return box
        return np.asarray(box + np.tile(centres(shown.box) - centres(box), 2), np.float32)

    def _follow(self, streams: Streams, around: Box) -> float:
        box, score = self._method.follow(streams, around)
        found = score >= self.rules.lost_score
        self._missed = 0 if found else self._missed + 1
        if found:
            self._box = box[None]
        return score

    def _compare(self, streams: Streams, shown: Proposal | None) -> None:
        """Count consecutive frames in which the policy chooses something else."""
        if shown is None or self._prompted:
            return
        if shown.object_id == NOBODY:
            seen = shows(streams.roi, self._box[0])
            self._hidden = 0 if seen else self._hidden + 1
            self._place += 1
            return
        self._hidden = self._place = 0
        if not same(self._box, shown.box[None]).item():
            self._apart += 1
            return
        self._apart, self._id = 0, shown.object_id
        if not self._missed:
            self._box = self._method.aligned(self._box[0], shown.box)[None]

    def _let_go(self, shown: Proposal | None) -> None:
        """Drop the object once one of the limits is reached."""
        rules = self.rules
        switched = shown is not None and shown.object_id not in (NOBODY, self._id)
        reasons = {
            "missed": self._missed >= rules.lost_after,
            "switch": switched and self._apart >= rules.switch_after,
            "drift": self._apart >= rules.drift_after,
            "hidden": self._hidden >= rules.hidden_after,
            "place": 0 < rules.place_after <= self._place,
        }
        if reason := next((name for name, reached in reasons.items() if reached), ""):
            self.lost[reason] += 1
            other = self._prompted or reason == "switch"  # something else is wanted now
            called = "" if other else self._called
            self._begin(TrackerState(called=called, size_px=self._size_px, lost_id=self._id))


def proposed(scanpath: Scanpath | None, seq: int) -> Proposal | None:
    """What a scanpath shows in frame `seq`; None where it does not speak of it, or with no box."""
    row = seq - scanpath.first_seq if scanpath else -1
    if scanpath is None or not 0 <= row < len(scanpath.choice):
        return None
    box, *later = scanpath.boxes[row : row + 2]
    if not (np.abs(box) < FAR_PX).all() or (box[2:] <= box[:2]).any():
        return None
    object_id, motion = max(int(scanpath.choice[row]), NOBODY), 0.0
    if later and (np.abs(later[0]) < FAR_PX).all():
        step_px = np.linalg.norm(centres(later[0]) - centres(box))
        motion = float(step_px / sizes(box[None])[0])
    return Proposal(object_id=object_id, box=box, motion=motion)


def shows(roi: Frame, box: Box) -> bool:
    """Whether the ROI shows at least half of a box; a sensor without a ROI shows everything."""
    if not roi.pixels.size:
        return True
    return bool(covered(box[None], np.array(roi.window, np.float32))[0] >= SHOWN)


def _startable(shown: Proposal, roi: Frame) -> bool:
    return shown.object_id != NOBODY and shows(roi, shown.box)
