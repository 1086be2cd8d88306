"""Made-up texts for the tests of the policies that read; fields of 1280x720, windows of 320x180."""

import numpy as np

from pipeline import Frame, Geometry, Percept, Tracks
from pipeline.testing import header

STREET = Geometry(width_px=1280, height_px=720, roi_width_px=320, roi_height_px=180)
Text = tuple[int, float, float, float]  # track id, centre x, centre y, height


def tracks(seq: int, *texts: Text, speed_px: float = 0.0, channels: int = 0) -> Tracks:
    """Return tracks of texts four times as wide as high, of which all move to the right."""
    rows = np.array(texts, np.float32).reshape(-1, 4)
    frames = np.arange(-3, 17)
    across = rows[:, 1:2] + frames * speed_px
    centre = np.stack([across, np.tile(rows[:, 2:3], len(frames))], axis=-1)
    half = (rows[:, 3:4] * np.array([2, 0.5], np.float32))[:, None]
    boxes = np.concatenate([centre - half, centre + half], axis=-1).astype(np.float32)
    return Tracks(
        header=header(seq, geometry=STREET),
        ids=rows[:, 0].astype(np.int32),
        labels=np.zeros(len(rows), np.int32),
        scores=np.full(len(rows), 0.5, np.float32),
        boxes=boxes[:, :4],
        visible=np.ones((len(rows), 4), np.bool_),
        features=np.ones((len(rows), 4, channels), np.float32) * rows[:, :1, None],
        predicted=boxes[:, 4:],
        names=("text",),
    )


def reading(seq: int, boxes: np.ndarray, *scores: float, text: str = "STOP") -> Percept:
    """Return what a reader reports of boxes (n, 4)."""
    return Percept(
        header=header(seq, geometry=STREET),
        boxes=boxes.astype(np.float32),
        ids=np.arange(len(boxes), dtype=np.int32),
        scores=np.array(scores, np.float32),
        texts=(text,) * len(boxes),
    )


def roi(seq: int, box: np.ndarray) -> Frame:
    """Return a ROI at a window (4,), with fewer pixels than it would have."""
    left, top, right, bottom = (int(side) for side in box)
    return Frame(
        header=header(seq, geometry=STREET),
        pixels=np.zeros((18, 32, 3), np.uint8),
        window=(left, top, right, bottom),
    )
