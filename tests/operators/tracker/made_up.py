"""A made-up world for the tracker: a moving textured object, and a still one, over a field."""

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame, Scanpath
from pipeline.boxes import centres, roi_window
from pipeline.testing import header

SIDE_PX = 40
FIELD = (0, 0, 1920, 1080)
AWAY = np.array([1500, 900], np.float32)  # far from both objects


class World:
    """The object's centre moves by `step` px right and down per frame, from (400, 300).

    The other object stays at (1220, 180).
    """

    def __init__(self, *, seed: int, step: tuple[int, int] = (7, 3)) -> None:
        self.step = step
        rng = np.random.default_rng(seed)
        rough = rng.integers(60, 120, (68, 120, 3), np.uint8)
        self.field = cv2.resize(rough, (1920, 1080), interpolation=cv2.INTER_CUBIC)
        self.object, self.other = (
            cv2.resize(
                rng.integers(0, 256, (5, 5, 3), np.uint8),
                (SIDE_PX, SIDE_PX),
                interpolation=cv2.INTER_CUBIC,
            )
            for _ in range(2)
        )

    def box(self, seq: int) -> NDArray[np.float32]:
        left, top = 380 + self.step[0] * seq, 280 + self.step[1] * seq
        return np.array([left, top, left + SIDE_PX, top + SIDE_PX], np.float32)

    def other_box(self) -> NDArray[np.float32]:
        return np.array([1200, 160, 1200 + SIDE_PX, 160 + SIDE_PX], np.float32)

    def picture(self, seq: int, *, hidden: bool = False) -> NDArray[np.uint8]:
        whole = self.field.copy()
        left, top, right, bottom = self.other_box().astype(int)
        whole[top:bottom, left:right] = self.other
        if not hidden:
            left, top, right, bottom = self.box(seq).astype(int)
            whole[top:bottom, left:right] = self.object
        return whole

    def frames(
        self,
        seq: int,
        *,
        roi: bool = True,
        hidden: bool = False,
        at: NDArray[np.float32] | None = None,
    ) -> dict[str, Frame]:
        """Return context at a quarter and ROI, around the object or `at`; empty without `roi`."""
        whole = self.picture(seq, hidden=hidden)
        small = cv2.resize(whole, (480, 270), interpolation=cv2.INTER_AREA)
        told = header(seq)
        middle = centres(self.box(seq)) if at is None else at
        window = roi_window(middle, told.geometry) if roi else (0, 0, 0, 0)
        part = np.ascontiguousarray(whole[window[1] : window[3], window[0] : window[2]])
        return {
            "context": Frame(header=told, pixels=small, window=FIELD),
            "roi": Frame(header=told, pixels=part, window=window),
        }

    def scanpath(
        self, seq: int, *, object_id: int, box: NDArray[np.float32] | None = None
    ) -> dict[str, Scanpath]:
        """Return a plan for four frames after `seq`: the object's boxes, or `box`, one or four."""
        choice = np.full(4, object_id, np.int32)
        ids = np.array([max(object_id, 0)], np.int32)
        own = np.stack([self.box(seq + 1 + k) for k in range(4)])
        boxes = own if box is None else np.broadcast_to(box, (4, 4))
        return {
            "scanpath": Scanpath(
                header=header(seq),
                ids=ids,
                probability=(choice[:, None] == ids).astype(np.float32),
                choice=choice,
                boxes=boxes.copy(),
                first_seq=seq + 1,
            )
        }
