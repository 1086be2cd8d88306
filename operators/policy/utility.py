"""Utility of looking at each candidate: predicted boxes and the truth -> utilities.

The paper trains "end-to-end with frozen task-specific perception models" and gives no loss. For
tracking, the frozen tracker gains where the ROI shows the target and its search area: U[i, t] is
the share of them inside the window that dispatch would command for candidate i at step t. A
neighbour of a hidden ball has nearly the utility of the ball, as its window shows both. The gain
falls with the square of the target's distance from the window's centre, because a centred target
stays inside even when it moves unlike its prediction.

`measured` is the gain of the shipped tracker itself, as `python -m bench.consumer_gain` finds it:
flat wherever the window shows the target whole, and nothing outside. Only the ball's could be
measured (IoU +.037 ± .028 at 1/64 of the pixels); people are followed as well in the context alone.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from pipeline import Geometry
from pipeline.boxes import centres, from_centres

SURROUNDINGS = 4.0  # side of the tracker's search area, in sides of the target's box
CENTRING = 0.5  # share of the gain lost at the window's edge
# halves of a window from its centre to the target, and the tracker's gain there, of the greatest
MEASURED = ((0.9, 1.0, 1.1), (1.0, 0.8, 0.0))
Array = NDArray[np.float32]


def windows(boxes: NDArray[np.float32], geometry: Geometry) -> NDArray[np.float32]:
    """`boxes.roi_window` of many boxes at once: (..., 4) -> (..., 4), sensor pixels."""
    size = np.array([geometry.roi_width_px, geometry.roi_height_px])
    most = np.array([geometry.width_px, geometry.height_px]) - size
    start = np.clip(np.rint(centres(boxes) - size / 2), 0, most)
    start -= start % geometry.step_px
    return np.concatenate([start, start + size], -1).astype(np.float32)


def gains(
    predicted: NDArray[np.float32], truth: NDArray[np.float32], geometry: Geometry
) -> NDArray[np.float32]:
    """Utility of each candidate at each step: (N, T, 4) and (T, 4) sensor pixels -> (N, T), 0..1.

    A row of `truth` without area means that the target is not in the picture: nothing is gained.
    """
    size, shown = truth[:, 2:] - truth[:, :2], windows(predicted, geometry)
    field = np.array([geometry.width_px, geometry.height_px] * 2, np.float32)
    window = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    around = np.minimum(size * SURROUNDINGS, window)
    wanted = np.clip(from_centres(centres(truth), around), 0, field)
    low = np.maximum(shown[..., :2], wanted[None, :, :2])
    high = np.minimum(shown[..., 2:], wanted[None, :, 2:])
    common = np.maximum(high - low, 0).prod(-1)
    whole = (wanted[:, 2:] - wanted[:, :2]).prod(-1)
    there = (size > 0).all(-1) & (whole > 0)
    share = common / np.where(there, whole, 1)
    gain = share * (1 - CENTRING * np.minimum(distances(shown, truth), 1) ** 2)
    return np.where(there, gain, 0).astype(np.float32)


def measured(predicted: Array, truth: Array, geometry: Geometry) -> Array:
    """Utility as `gains` has it, but in the form that the tracker's own gain has."""
    there = (truth[:, 2:] > truth[:, :2]).all(-1)
    gain = np.interp(distances(windows(predicted, geometry), truth), *MEASURED)
    return np.where(there, gain, 0).astype(np.float32)


def distances(shown: Array, truth: Array) -> Array:
    """Halves of a window (N, T, 4) from its centre to the target's (T, 4), greater axis: (N, T)."""
    half = (shown[..., 2:] - shown[..., :2]) / 2
    away = np.abs(centres(shown) - centres(truth)) / half
    return np.asarray(away.max(-1), np.float32)


UTILITIES: Mapping[str, Callable[[Array, Array, Geometry], Array]] = {
    "geometric": gains, "measured": measured,
}  # fmt: skip
