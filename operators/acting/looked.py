"""What the ROI has shown, in the context's grid: contexts and windows in, a state out.

It foresees what a consumer that keeps sharp parts still knows: a part that the ROI showed is known
until the context there changes.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline import Geometry, Shape

NEVER = -1
Windows = NDArray[np.float32]  # (n, 4) xyxy, sensor pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Looked:
    """Immutable; without pixels before the first frame."""

    reference: Annotated[NDArray[np.uint8], Shape.of("h", "w", 3)]  # context when it was last known
    known: Annotated[NDArray[np.bool_], Shape.of("h", "w")]
    shown_seq: Annotated[NDArray[np.int32], Shape.of("h", "w")]  # last frame that showed it, NEVER


def nothing_looked() -> Looked:
    """Return the state before the first frame."""
    return Looked(
        reference=np.zeros((0, 0, 3), np.uint8),
        known=np.zeros((0, 0), np.bool_),
        shown_seq=np.zeros((0, 0), np.int32),
    )


def followed(before: Looked, context: NDArray[np.uint8], change_levels: float) -> Looked:
    """Return the state after a context (h, w, 3): what has changed is known no more.

    `change_levels`: of 255, in the channel that differs most.
    """
    if before.reference.shape != context.shape:
        return Looked(
            reference=context.copy(),
            known=np.zeros(context.shape[:2], np.bool_),
            shown_seq=np.full(context.shape[:2], NEVER, np.int32),
        )
    apart = np.abs(context.astype(np.int16) - before.reference).max(2)
    known = before.known & (apart < change_levels)
    reference = np.where(known[..., None], before.reference, context)
    return replace(before, reference=reference, known=known)


def shown(
    before: Looked,
    context: NDArray[np.uint8],
    window: tuple[int, int, int, int],
    geometry: Geometry,
    seq: int,
) -> Looked:
    """Return the state after the ROI showed a window in the frame of this context."""
    rows, columns = _cells(window, before.known.shape, geometry)
    known, shown_seq = before.known.copy(), before.shown_seq.copy()
    reference = before.reference.copy()
    known[rows, columns], shown_seq[rows, columns] = True, seq
    reference[rows, columns] = context[rows, columns]
    return Looked(reference=reference, known=known, shown_seq=shown_seq)


def means(values: NDArray[np.float32], windows: Windows, geometry: Geometry) -> Windows:
    """Return the mean (n,) of a map (h, w) over each window; 0 where a window holds no pixel."""
    height, width = values.shape
    total = np.zeros((height + 1, width + 1), np.float64)
    total[1:, 1:] = values.cumsum(0).cumsum(1)
    sides = np.array([geometry.width_px, geometry.height_px] * 2, np.float32)
    cells = np.rint(windows / sides * np.array([width, height] * 2, np.float32)).astype(np.int64)
    left, top, right, bottom = np.clip(cells, 0, [width, height, width, height]).T
    summed = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    count = np.maximum(right - left, 0) * np.maximum(bottom - top, 0)
    return np.where(count > 0, summed / np.maximum(count, 1), 0).astype(np.float32)


def _cells(
    window: tuple[int, int, int, int], shape: tuple[int, ...], geometry: Geometry
) -> tuple[slice, slice]:
    """Return the rows and columns of a map (h, w) that lie in a window."""
    across, down = shape[1] / geometry.width_px, shape[0] / geometry.height_px
    left, top, right, bottom = window
    return (
        slice(round(top * down), round(bottom * down)),
        slice(round(left * across), round(right * across)),
    )
