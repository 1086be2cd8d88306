"""A policy that knows the truth: it looks at the legible text that is most worth a look.

It is given the truth of the frame that it plans for, and hears the reader. Of the windows around
the texts that are legible and unread, it takes the one with most of them; of several, the one that
will leave the picture first.
"""

import numpy as np

from bench.reading.known import Knowing, NothingToSet
from operators.transcribed import ILLEGIBLE, matches, plain
from pipeline import Frame, Header, Input, Percept, RoiFeatures, Scanpath, Tracks
from pipeline.boxes import centres, covered, roi_window

TRIES = 3  # looks at a text that is not read for all that
POSITION = -1


class Oracle(Knowing[NothingToSet, Scanpath]):
    """Takes the place of a policy."""

    tracks = Input(Tracks, keep="every")
    features = Input(RoiFeatures, join=False, optional=True)
    percept = Input(Percept, join=False)
    roi = Input(Frame, join=False, optional=True)

    def open(self) -> None:
        """Start without readings."""
        self._read: set[int] = set()
        self._looks: dict[int, int] = {}

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other texts."""
        self.open()

    def on_features(self, features: RoiFeatures) -> None:
        """Do nothing."""

    def on_roi(self, roi: Frame) -> None:
        """Do nothing."""

    def on_percept(self, percept: Percept) -> None:
        """Note which texts are read correctly."""
        truth = self.truth_of(percept.header.seq)
        if truth is None:
            return
        for row, column in matches(percept.boxes, truth.boxes):
            if plain(percept.texts[row]) == plain(truth.labels[column]):
                self._read.add(int(truth.ids[column]))

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the next frame."""
        geometry, seq = tracks.header.geometry, tracks.header.seq + 1
        truth = self.truth_of(seq)
        wanted = [
            row
            for row, (id_, label) in enumerate(
                zip(truth.ids.tolist(), truth.labels, strict=True) if truth else ()
            )
            if label != ILLEGIBLE and id_ not in self._read and self._looks.get(id_, 0) < TRIES
        ]
        middle = np.array([geometry.width_px, geometry.height_px] * 2, np.float32) / 2
        box = middle
        if truth is not None and wanted:
            boxes = truth.boxes[wanted]
            windows = np.array([roi_window(each, geometry) for each in centres(boxes)], np.float32)
            shown = np.array([covered(boxes, window) >= 0.99 for window in windows])
            soon = np.abs(centres(boxes) - middle[:2]).max(1) / 1e6  # leaves first
            best = int((shown.sum(1) + soon).argmax())
            box = boxes[best]
            for row in np.flatnonzero(shown[best]):
                id_ = int(truth.ids[wanted[row]])
                self._looks[id_] = self._looks.get(id_, 0) + 1
        return Scanpath(
            header=tracks.header,
            ids=np.zeros(0, np.int32),
            probability=np.zeros((1, 0), np.float32),
            choice=np.array([POSITION], np.int32),
            boxes=box[None].astype(np.float32),
            first_seq=seq,
        )
