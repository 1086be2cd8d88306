"""Parts of the loop that know the truth, to measure what each part costs: `--replace`.

An operator of these takes the place of the graph's own at a node; the evaluation sets `truth_of`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from drivers.source import Annotations
from operators.transcribed import ILLEGIBLE
from pipeline import Detections, Frame, Header, Input, Operator, Percept, Tracks
from pipeline.boxes import covered

CHANNELS = 64  # features of a detection, as the detector of texts has them
LEAST_VISIBLE = 0.5  # of a text, to be detected
WHOLE = 0.99  # share of a text in the ROI, to be read

S = TypeVar("S")
Out = TypeVar("Out")


class Knowing(Operator[S, Out]):
    """What these share."""

    truth_of: Callable[[int], Annotations | None]  # frame -> truth, None past the end


@dataclass(frozen=True, kw_only=True)
class NothingToSet:
    """Nothing to set."""


class TrueDetections(Knowing[NothingToSet, Detections]):
    """Finds every text, whether legible or not, in place and without features."""

    frame = Input(Frame, keep="latest")

    def on_frame(self, frame: Frame) -> Detections:
        """Return the texts that are there."""
        truth = self.truth_of(frame.header.seq)
        rows = np.zeros(0, int) if truth is None else np.flatnonzero(_there(truth))
        boxes = np.zeros((0, 4), np.float32) if truth is None else truth.boxes[rows]
        return Detections(
            header=frame.header,
            boxes=boxes.astype(np.float32),
            angles=np.zeros(len(rows), np.float32),
            scores=np.ones(len(rows), np.float32),
            labels=np.zeros(len(rows), np.int32),
            features=np.zeros((len(rows), CHANNELS), np.float32),
            names=("text",),
        )


class TrueReader(Knowing[NothingToSet, Percept]):
    """Reads every legible text that the ROI shows whole, at once and without error."""

    context = Input(Frame, keep="latest")
    roi = Input(Frame, keep="latest")
    tracks = Input(Tracks, join=False)

    def open(self) -> None:
        """Start without texts."""
        self._read: dict[int, str] = {}

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other texts."""
        self._read = {}

    def on_tracks(self, tracks: Tracks) -> None:
        """Do nothing."""

    def on_context_roi(self, context: Frame, roi: Frame) -> Percept:
        """Return what was read so far and is in view."""
        truth = self.truth_of(roi.header.seq)
        ids = [] if truth is None else truth.ids.tolist()
        if truth is not None and roi.pixels.size:
            shown = covered(truth.boxes, np.array(roi.window, np.float32)) >= WHOLE
            for id_, label, whole in zip(ids, truth.labels, shown, strict=True):
                if whole and label != ILLEGIBLE:
                    self._read[id_] = label
        rows = [row for row, id_ in enumerate(ids) if id_ in self._read]
        boxes = np.zeros((0, 4), np.float32) if truth is None else truth.boxes[rows]
        return Percept(
            header=roi.header,
            boxes=boxes.astype(np.float32),
            ids=np.array([ids[row] for row in rows], np.int32),
            scores=np.ones(len(rows), np.float32),
            texts=tuple(self._read[ids[row]] for row in rows),
        )


def _there(truth: Annotations) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(truth.visibility >= LEAST_VISIBLE, np.bool_)
