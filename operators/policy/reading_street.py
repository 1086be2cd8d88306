"""A recorded clip with texts, and a reader that is simulated: windows in, what was read out.

The simulated reader stands in for the real one in roll-outs: it reads a text that a window shows
with the chance of readability.py. Half of its luck belongs to the text, so that a text that was not
read is less likely to be read at the next look.
"""

import numpy as np
from numpy.typing import NDArray

from operators.policy.data import Moment, Recording
from operators.policy.looks import INSIDE
from operators.policy.readability import chances, heights
from pipeline import Percept
from pipeline.boxes import covered

UNSCORED = "###"  # the transcription of a text that is not to be read in a frame
OWN_LUCK = 0.5  # share of looks at which the text's own luck decides
SURE, UNSURE = (0.85, 1.0), (0.3, 0.75)  # scores of right and of wrong readings
WRONG = 0.3  # chance of a wrong reading where a text was shown and not read
Array = NDArray[np.float32]


class Street:
    """The truth of a recording as arrays over F frames and K texts that are legible at all."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.geometry = recording, recording.geometry
        truths = [self.moment(frame).truth for frame in range(len(recording))]
        able = [np.array([label != UNSCORED for label in t.labels], np.bool_) for t in truths]
        rows = [t.ids[a] for t, a in zip(truths, able, strict=True)]
        self.ids = np.unique(np.concatenate([np.zeros(0, np.int32), *rows]))
        shape = (len(recording), len(self.ids))
        self.boxes = np.zeros((*shape, 4), np.float32)  # zeros: not in the picture
        self.chance = np.zeros(shape, np.float32)  # of reading it in one look
        self.legible = np.zeros(shape, np.bool_)
        for frame, (truth, readable) in enumerate(zip(truths, able, strict=True)):
            kept = np.isin(truth.ids, self.ids)
            column = np.searchsorted(self.ids, truth.ids[kept])
            self.boxes[frame, column] = truth.boxes[kept]
            self.legible[frame, column] = readable[kept]
            self.chance[frame, column] = chances(heights(truth.boxes[kept])) * readable[kept]

    def __len__(self) -> int:
        return len(self.recording)

    def moment(self, frame: int) -> Moment:
        """Frame `frame`, counted from 0."""
        return self.recording.moment(frame)

    def shown(self, windows: Array, frames: slice) -> Array:
        """Return the chance that windows (n, T, 4) read each text in T frames: (n, K, T)."""
        boxes, chance = self.boxes[frames], self.chance[frames]  # (T, K, 4), (T, K)
        low = np.maximum(windows[:, :, None, :2], boxes[None, ..., :2])
        high = np.minimum(windows[:, :, None, 2:], boxes[None, ..., 2:])
        common = np.maximum(high - low, 0).prod(-1)
        whole = np.maximum((boxes[..., 2:] - boxes[..., :2]).prod(-1), 1e-9)
        inside = common >= INSIDE * whole
        return np.asarray((inside * chance).transpose(0, 2, 1), np.float32)


class SimulatedReader:
    """What was read of one street so far; deterministic for its seed."""

    def __init__(self, street: Street, seed: int) -> None:
        self._street, self._rng = street, np.random.default_rng([seed, 3])
        count = len(street.ids)
        self._luck = self._rng.random(count)
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
        inside = covered(boxes, window) >= INSIDE
        luck = np.where(rng.random(count) < OWN_LUCK, self._luck, rng.random(count))
        right = inside & (luck < chance)
        wrong = inside & ~right & (rng.random(count) < WRONG)
        score = np.where(right, rng.uniform(*SURE, count), rng.uniform(*UNSURE, count) * wrong)
        self.read_at = np.where(right & ~self.read, frame, self.read_at)
        readable = inside & (chance >= 0.5) & (self.shown_at < 0)
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
