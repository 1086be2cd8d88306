"""A recorded clip with texts, and a reader that is simulated: windows in, what was read out.

The simulated reader stands in for the real one in roll-outs: it reads a text that a window shows
with the chance of readability.py, and often reports something else, as surely, where it does not.
Most of its luck belongs to the text, so that one that was not read is less likely to be read at the
next look.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from operators.policy.data import Moment, Recording
from operators.policy.readability import chances, heights
from pipeline import Percept
from pipeline.boxes import covered

UNSCORED = "###"  # the transcription of a text that is not to be read in a frame
LEAST_VISIBLE = 0.85  # share of a text that must be seen
READABLE = 0.5  # chance from which a text is shown at a readable size
WHOLE = 0.98  # share that a window must show
OWN_LUCK = 0.7  # share of looks at which the text's own luck decides
SURE = (0.85, 1.0)  # scores of readings, right or wrong: the reader's score hardly tells them apart
LARGE_PX = 12.0  # height from which a text that is not read rightly is mostly read wrongly
WRONG, SELDOM = 0.6, 0.1  # chances of that, for large texts and unscored ones, and for others
Array = NDArray[np.float32]


class Street:
    """The truth of a recording as arrays over F frames and its K texts.

    `roi_scale` is the side of the ROI, of the one that was recorded: no other output depends on it.
    """

    def __init__(self, recording: Recording, roi_scale: float = 1.0) -> None:
        self.recording, field = recording, recording.geometry
        self.geometry = replace(
            field,
            roi_width_px=field.aligned(round(field.roi_width_px * roi_scale)),
            roi_height_px=field.aligned(round(field.roi_height_px * roi_scale)),
        )
        truths = [self.moment(frame).truth for frame in range(len(recording))]
        self.ids = np.unique(np.concatenate([t.ids for t in truths]))
        shape = (len(recording), len(self.ids))
        self.boxes = np.zeros((*shape, 4), np.float32)  # zeros: not in the picture
        self.legible = np.zeros(shape, np.bool_)
        seen = np.zeros(shape, np.bool_)
        for frame, truth in enumerate(truths):
            column = np.searchsorted(self.ids, truth.ids)
            self.boxes[frame, column] = truth.boxes
            self.legible[frame, column] = [label != UNSCORED for label in truth.labels]
            seen[frame, column] = truth.visibility >= LEAST_VISIBLE
        self.counts = self.legible.any(0)  # (K,) legible in some frame
        size = heights(self.boxes)
        self.chance = chances(size) * (seen & self.counts)  # (F, K) of reading it in one look
        wrong = np.where(self.counts & (size < LARGE_PX), SELDOM, WRONG)
        self.wrong = wrong * (chances(size) > 0)  # (F, K) of a wrong reading otherwise

    def __len__(self) -> int:
        return len(self.recording)

    def moment(self, frame: int) -> Moment:
        """Frame `frame`, counted from 0."""
        found = self.recording.moment(frame)
        header = replace(found.tracks.header, geometry=self.geometry)
        return replace(found, tracks=replace(found.tracks, header=header))

    def shown(self, windows: Array, frames: slice) -> Array:
        """Return the chance that windows (n, T, 4) read each text in T frames: (n, K, T)."""
        boxes, chance = self.boxes[frames], self.chance[frames]  # (T, K, 4), (T, K)
        low = np.maximum(windows[:, :, None, :2], boxes[None, ..., :2])
        high = np.minimum(windows[:, :, None, 2:], boxes[None, ..., 2:])
        common = np.maximum(high - low, 0).prod(-1)
        whole = np.maximum((boxes[..., 2:] - boxes[..., :2]).prod(-1), 1e-9)
        inside = common >= WHOLE * whole
        return np.asarray((inside * chance).transpose(0, 2, 1), np.float32)


class SimulatedReader:
    """What was read of one street so far; deterministic for its seed."""

    def __init__(self, street: Street, seed: int) -> None:
        self._street, self._rng = street, np.random.default_rng([seed, 3])
        count = len(street.ids)
        self._luck, self._guess = self._rng.random(count), self._rng.random(count)
        self.score = np.zeros(count, np.float32)  # of the best reading, right or wrong
        self.read_at = np.full(count, -1)  # frame in which it was read rightly
        self.shown_at = np.full(count, -1)  # first frame that showed it at a readable size

    @property
    def read(self) -> NDArray[np.bool_]:
        """Which texts (K,) were read rightly."""
        return self.read_at >= 0

    def look(self, window: Array, frame: int) -> Percept:
        """Read what a window (4,) shows in a frame; return all readings of texts in the picture."""
        street, rng, count = self._street, self._rng, len(self._street.ids)
        boxes, chance = street.boxes[frame], street.chance[frame]
        inside = covered(boxes, window) >= WHOLE
        own = rng.random(count) < OWN_LUCK
        right = inside & (np.where(own, self._luck, rng.random(count)) < chance)
        guess = np.where(own, self._guess, rng.random(count))
        wrong = inside & ~right & (guess < street.wrong[frame])
        score = rng.uniform(*SURE, count) * (right | wrong)
        self.read_at = np.where(right & ~self.read, frame, self.read_at)
        readable = inside & (chance >= READABLE) & (self.shown_at < 0)
        self.shown_at = np.where(readable, frame, self.shown_at)
        self.score = np.maximum(self.score, score).astype(np.float32)
        told = (self.score > 0) & (boxes[:, 2] > boxes[:, 0])
        return Percept(
            header=street.recording.header(frame),
            boxes=boxes[told],
            ids=street.ids[told],
            scores=self.score[told],
            texts=("read",) * int(told.sum()),
        )
