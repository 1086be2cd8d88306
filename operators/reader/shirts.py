"""Read what persons wear: ROI and tracks -> Percept with the texts that this exposure shows.

A detector of texts does not see a number of three pixels in the context, and PP-OCR's own passes
over one or two digits between arms. Where persons are is known, though, and so is where a shirt
has its number: that part of each person's box is read as one line.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from operators.reader.ctc import LineReader, OnnxReaderSettings, cut
from operators.reader.instances import Instances
from operators.reader.ocr import Reading
from pipeline import Frame, SettingsError
from pipeline.boxes import boxes_at, covered, in_picture, parts_of

NUMBERS = "[1-9][0-9]?"
LEAST_PX = 5.0  # height of a line in the picture: nothing smaller is read
MOST_PERSONS = 32  # read in one frame
INSIDE = 0.95  # share of the part that the picture must show
LAST_ID = 2**31 - 1 - 2 * MOST_PERSONS  # of a reading before those of one exposure; then from 1


@dataclass(frozen=True, kw_only=True)
class ShirtReaderSettings(OnnxReaderSettings):
    """What a graph may set; `forget_after` has no meaning, as nothing is kept."""

    # left, top, right, low of what is read, shares of a person's box
    part: tuple[float, float, float, float] = (0.26, 0.30, 0.74, 0.46)
    pattern: str = NUMBERS  # a regular expression that a whole text must match; empty: any text

    def __post_init__(self) -> None:
        super().__post_init__()
        left, top, right, low = self.part
        if not (0 <= left < right <= 1 and 0 <= top < low <= 1):
            raise SettingsError(
                f"part: expected left, top, right, low within 0..1, got {list(self.part)}"
            )
        try:
            re.compile(self.pattern)
        except re.error as error:
            raise SettingsError(f"pattern: expected a regular expression: {error}") from error


class ShirtReader(LineReader[ShirtReaderSettings]):
    """Reads each person in the picture anew; nothing is collected: persons move.

    `operators.name_tracks:NameTracks` binds the readings to tracks and keeps them.
    """

    def open(self) -> None:
        """Load the network."""
        super().open()
        self.forget_after = 0
        self._instances = Instances(self.forget_after)
        self._wanted = re.compile(self.settings.pattern or ".*")

    def read(self, frame: Frame) -> list[Reading]:
        """Read the persons that the picture shows, the largest first.

        Nothing is read where it is not known where they were, as in a frame older than the tracks.
        """
        if self._instances.next_id > LAST_ID:  # each reading has an id of its own, of 32 bit
            self._instances.next_id = 1
        boxes = None if self._tracks is None else boxes_at(self._tracks, frame.header.seq)
        if boxes is None or not len(boxes):
            return []
        parts = parts_of(boxes, self.settings.part)
        shown = covered(parts, np.array(frame.window, np.float32)) >= INSIDE
        scale = frame.pixels.shape[0] / (frame.window[3] - frame.window[1])
        tall = parts[:, 3] - parts[:, 1]
        rows = np.flatnonzero(shown & (tall * scale >= LEAST_PX))
        rows = rows[np.argsort(-tall[rows], kind="stable")][:MOST_PERSONS]
        pixels = np.asarray(frame.pixels, np.uint8)
        found = []
        for row in rows:
            box = in_picture(parts[row], frame)
            text, score = self._recogniser(cut(pixels, box))
            if score >= self.settings.least_score and text and self._wanted.fullmatch(text):
                left, top, right, low = box.tolist()
                found.append(Reading(text=text, score=score, box=(left, top, right, low)))
        return found

    def summary(self) -> Mapping[str, Any]:
        """How much was read; how many persons that were is not known here."""
        return {"frames": self._frames, "readings": self._readings}

    def headline(self) -> str:
        """How many readings there were."""
        return f"{self._readings} readings"
