"""A MOT Challenge sequence (MOT15, 16, 17, 20): its folder in, pictures, truth, detections out."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.sequence import (
    NumberedPictures,
    Row,
    by_frame,
    no_objects,
    read_info,
    read_rows,
)
from drivers.source import Annotations
from pipeline.errors import DriverError

# column 8 of gt.txt, MOT16 paper, table 3; MOT15 writes -1 there and knows only pedestrians
CLASSES = {
    -1: "pedestrian",
    1: "pedestrian",
    2: "person on vehicle",
    3: "car",
    4: "bicycle",
    5: "motorbike",
    6: "non motorized vehicle",
    7: "static person",
    8: "distractor",
    9: "occluder",
    10: "occluder on the ground",
    11: "occluder full",
    12: "reflection",
    13: "crowd",
}


class MotSequence:
    """A `FrameSource` over `<folder>/{seqinfo.ini, img1/, gt/gt.txt, det/det.txt}`.

    Rows flagged 0 (to be ignored) are left out of the truth. Test sequences have no truth.
    """

    def __init__(self, *, path: str) -> None:
        folder = Path(path)
        info = read_info(folder)
        self.size_px, self.rate_hz = info.size_px, info.rate_hz
        self.length: int | None = info.length
        self._pictures = NumberedPictures(info)
        self._truth = _read_truth(folder / "gt" / "gt.txt")
        self._detections = _read_detections(folder / "det" / "det.txt")

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        return self._pictures.picture(index)

    def truth(self, index: int) -> Annotations | None:
        """Return the objects in frame `index`, with the visible share of each."""
        return None if self._truth is None else self._truth.get(index, no_objects())

    def detections(self, index: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return a frame's public detections: boxes (n, 4) xyxy, confidence (n,); n may be 0."""
        rows = self._detections.get(index, [])
        boxes = np.array([r.box for r in rows], np.float32).reshape(-1, 4)
        return boxes, np.array([r.rest[0] for r in rows], np.float32)

    def close(self) -> None:
        """Do nothing: no file is open between pictures."""


def _read_truth(path: Path) -> dict[int, Annotations] | None:
    if not path.is_file():
        return None
    rows: list[Row] = []
    labels, visible = [], []
    for row in read_rows(path, columns=9):
        flag, number, share = row.rest[:3]
        if number not in CLASSES:
            raise DriverError(f"{path}:{row.line}: expected a class from 1 to 13, got {number:g}")
        if flag == 0:
            continue
        rows.append(row)
        labels.append(CLASSES[int(number)])
        visible.append(share if len(row.rest) == 3 and 0 <= share <= 1 else 1.0)
    return by_frame(rows, labels, visible)


def _read_detections(path: Path) -> dict[int, list[Row]]:
    found: dict[int, list[Row]] = {}
    if path.is_file():
        for row in read_rows(path, columns=7):
            found.setdefault(row.index, []).append(row)
    return found
