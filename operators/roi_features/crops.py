"""Cut squares out of a picture: boxes and a frame -> small pictures of one size."""

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame

FILL = 114  # grey around what the frame does not show


def to_squares(boxes: NDArray[np.float32], roi: Frame, margin: float) -> NDArray[np.float32]:
    """Squares around boxes, with a margin: (n, 4) sensor pixels -> (n, 4) xyxy, ROI pixels."""
    left, top, right, bottom = roi.window
    scale = np.array(
        [roi.pixels.shape[1] / (right - left), roi.pixels.shape[0] / (bottom - top)], np.float32
    )
    low = (boxes[:, :2] - np.array([left, top], np.float32)) * scale
    high = (boxes[:, 2:] - np.array([left, top], np.float32)) * scale
    half = (high - low).max(1, keepdims=True) * np.float32((1 + margin) / 2)
    middle = (low + high) / 2
    return np.concatenate([middle - half, middle + half], 1)


def cut(picture: NDArray[np.uint8], square: NDArray[np.float32], canvas: NDArray[np.uint8]) -> None:
    """Scale one square of a picture (h, w, 3) into `canvas` (s, s, 3); outside it is grey."""
    side = max(float(square[2] - square[0]), 1.0)
    limits = np.array(picture.shape[1::-1] * 2)
    whole = np.clip(np.round(square).astype(int), 0, limits)
    height_px, width_px = canvas.shape[:2]
    gain = np.array([width_px, height_px] * 2) / side
    target = np.round((whole - np.tile(square[:2], 2)) * gain).astype(int)
    x0, y0, x1, y1 = np.clip(target, 0, [width_px, height_px] * 2)
    canvas[:] = FILL
    if x1 <= x0 or y1 <= y0 or whole[2] <= whole[0] or whole[3] <= whole[1]:
        return
    part = picture[whole[1] : whole[3], whole[0] : whole[2]]
    # averaging what is shrunk keeps shirt numbers from breaking up
    how = cv2.INTER_AREA if gain[0] < 1 else cv2.INTER_LINEAR
    canvas[y0:y1, x0:x1] = cv2.resize(part, (int(x1 - x0), int(y1 - y0)), interpolation=how)
