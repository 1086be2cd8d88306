"""A fake of detector, filter and policy: it detects the square of `MovingSquare`."""

from dataclasses import dataclass

import numpy as np

from pipeline.contract import Input, Operator
from pipeline.messages import Frame, Scanpath
from tests.drivers.moving_square import SIDE_PX, SPEED_PX

HORIZON = 8


@dataclass(frozen=True, kw_only=True)
class SeerSettings:
    """Whether it predicts the motion or assumes that everything stands still."""

    foresees: bool = True


class Seer(Operator[SeerSettings, Scanpath]):
    """Frame -> Scanpath around the brightest place, moved along."""

    frame = Input(Frame, keep="latest")

    def on_frame(self, frame: Frame) -> Scanpath:
        brightness = frame.pixels.astype(np.int32).sum(axis=2)
        row, column = np.unravel_index(int(brightness.argmax()), brightness.shape)
        scale = frame.window[2] / frame.pixels.shape[1]
        left, top = float(column) * scale, float(row) * scale
        box = np.array([left, top, left + SIDE_PX, top + SIDE_PX], np.float32)
        steps = np.arange(1, HORIZON + 1, dtype=np.float32) * self.settings.foresees
        boxes = box + steps[:, None] * np.array([SPEED_PX, 0, SPEED_PX, 0], np.float32)
        return Scanpath(
            header=frame.header,
            ids=np.zeros(1, np.int32),
            probability=np.ones((HORIZON, 1), np.float32),
            choice=np.zeros(HORIZON, np.int32),
            boxes=boxes.astype(np.float32),
            first_seq=frame.header.seq + 1,
        )
