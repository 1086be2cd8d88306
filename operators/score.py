"""Compare a consumer's box with the ground truth, if the source knows it: Percept, Truth -> IoU.

The reference object is:
- with a `label`, an object of that class: of several, the one with the greatest overlap;
- with a scanpath connected, the policy's object. It is the true object that overlaps the box
  predicted for the policy's choice, and changes when that box is on another object for `SETTLED`
  frames. A choice on no object, or a position, changes nothing, so that a policy that loses its
  target does not excuse its consumer. The consumer's own box is not considered. Whether the policy
  chose the prompted object is measured separately, by the ROI's coverage or by a label;
- else the object that the consumer's box overlapped when it started or changed its id.

From then on, every frame in which that object is visible counts. A frame without a box (lost)
counts as 0, so that silence gains nothing; the share of frames with a box is reported as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import iou
from pipeline.contract import HEADLINE, Input, Operator
from pipeline.errors import MessageError, SettingsError
from pipeline.messages import Header, Percept, Scanpath, Truth

NOBODY = -1
SAME_IOU = 0.3  # IoU from which a box is on an object; neighbours overlap a little, too
SETTLED = 3  # frames on another object before the reference changes
RECENT = 0.05  # weight of a frame in the headline


@dataclass(frozen=True, kw_only=True)
class ScoreSettings:
    """What a graph may set."""

    label: str = ""  # of the truth to compare with, e.g. ball; empty: what is shown or followed
    least_visible: float = 0.25  # share of the object below which a frame does not count

    def __post_init__(self) -> None:
        if not 0 <= self.least_visible <= 1:
            raise SettingsError(f"least_visible: must be within 0..1, got {self.least_visible}")


@dataclass(frozen=True, kw_only=True)
class ScoreState:
    """The counts and the reference object."""

    total: float
    recent: float
    frames: int
    answered: int
    object: int
    followed_id: int
    rival: int
    rival_frames: int


class Score(Operator[ScoreSettings, None]):
    """Sends nothing; its figure is shown while the graph runs, and in the report."""

    live = ("label", "least_visible")
    percept = Input(Percept, keep="latest")
    truth = Input(Truth, keep="latest")
    scanpath = Input(Scanpath, join=False, optional=True)

    _scanpath: Scanpath | None = None

    def open(self) -> None:
        """Start with empty counts."""
        self._total, self._recent, self._frames, self._answered = 0.0, 0.0, 0, 0
        self._begin()

    def on_stream(self, header: Header) -> None:
        """Forget the reference object of another stream."""
        self._begin()

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Store the policy's plan."""
        self._scanpath = scanpath

    def on_percept_truth(self, percept: Percept, truth: Truth) -> None:
        """Count one frame in which the object can be seen.

        Raises `MessageError` for a truth whose labels do not fit its boxes.
        """
        if len(truth.labels) != len(truth.boxes):
            got = f"{len(truth.labels)} for {len(truth.boxes)} boxes"
            raise MessageError(f"truth.labels: expected one for each box, got {got}")
        overlap = np.zeros(len(truth.boxes), np.float32)
        if len(percept.boxes):
            overlap = iou(truth.boxes, percept.boxes[:1])[:, 0]
        row = self._row(percept, truth, overlap)
        if row < 0 or truth.visibility[row] < self.settings.least_visible:
            return
        value = float(overlap[row])
        self._recent += (RECENT if self._frames else 1.0) * (value - self._recent)
        self._total += value
        self._frames += 1
        self._answered += len(percept.boxes) > 0

    def state(self) -> ScoreState:
        """Return the counts for a successor."""
        return ScoreState(
            total=self._total,
            recent=self._recent,
            frames=self._frames,
            answered=self._answered,
            object=self._object,
            followed_id=self._followed_id,
            rival=self._rival,
            rival_frames=self._rival_frames,
        )

    def restore(self, state: ScoreState) -> None:
        """Take over the counts; the policy sends its plan again."""
        self._total, self._recent = state.total, state.recent
        self._frames, self._answered = state.frames, state.answered
        self._object, self._followed_id = state.object, state.followed_id
        self._rival, self._rival_frames = state.rival, state.rival_frames

    def headline(self) -> str:
        """Return the current figure."""
        return f"IoU {self._recent:.2f}" if self._frames else ""

    def summary(self) -> Mapping[str, Any]:
        """The mean over all frames that counted, and the share of them with a box."""
        if not (frames := self._frames):
            return {}
        figures = {"mean": round(self._total / frames, 4), "frames": frames}
        share = f"{self._answered / frames:.1%}" if self._answered < frames else "all"
        counted = f"{frames} frame" + ("s" if frames > 1 else "")
        return {
            "iou": {**figures, "answered": round(self._answered / frames, 4)},
            HEADLINE: f"IoU {self._total / frames:.3f} with the truth over {counted}, "
            f"a box in {share} of them",
        }

    def _begin(self) -> None:
        self._object = self._rival = self._followed_id = NOBODY
        self._rival_frames = 0
        self._scanpath = None

    def _row(self, percept: Percept, truth: Truth, overlap: NDArray[np.float32]) -> int:
        """Which object to compare with: a row of the truth, -1: none."""
        if self.settings.label:
            rows = np.flatnonzero(np.array(truth.labels) == self.settings.label)
            return int(rows[overlap[rows].argmax()]) if len(rows) else -1
        if self._scanpath is not None:
            self._score_shown(foreseen(self._scanpath, percept.header.seq), truth)
        elif len(percept.boxes) and (self._object == NOBODY or self._followed_id != NOBODY):
            # without a policy; a successor waits for the plan with what was shown before
            self._score_followed(int(percept.ids[0]), truth, overlap)
        rows = np.flatnonzero(truth.ids == self._object)
        return int(rows[0]) if len(rows) else -1

    def _score_shown(self, box: NDArray[np.float32], truth: Truth) -> None:
        """Change the reference object once the policy has been on another for long enough."""
        found = on_object(iou(truth.boxes, box)[:, 0], truth) if len(box) else NOBODY
        if found == NOBODY:
            return
        if found == self._object or found != self._rival:
            self._rival, self._rival_frames = found, 0
        self._rival_frames += 1
        if self._object == NOBODY or self._rival_frames >= SETTLED:
            self._object = found

    def _score_followed(self, own_id: int, truth: Truth, overlap: NDArray[np.float32]) -> None:
        """Change the reference object when the consumer's id changes."""
        if self._object != NOBODY and own_id == self._followed_id:
            return
        if (found := on_object(overlap, truth)) != NOBODY:
            self._object, self._followed_id = found, own_id


def on_object(overlap: NDArray[np.float32], truth: Truth) -> int:
    """Id of the object that a box with these overlaps (n,) is on, `NOBODY` for none."""
    if not len(overlap) or overlap.max() < SAME_IOU:
        return NOBODY
    return int(truth.ids[overlap.argmax()])


def foreseen(scanpath: Scanpath, seq: int) -> NDArray[np.float32]:
    """Where the policy's object is foreseen in frame `seq`: (1, 4), (0, 4) for none or a place."""
    row = seq - scanpath.first_seq
    chosen = 0 <= row < len(scanpath.choice) and scanpath.choice[row] >= 0
    return scanpath.boxes[row : row + 1] if chosen else scanpath.boxes[:0]
