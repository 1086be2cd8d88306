"""What changed since the frame before, the camera's own movement taken out: picture -> difference.

A flying ball is a faint streak in one picture and the strongest change between two. The camera's
movement is a similarity (shift, turn, zoom) between corners that are followed from one picture to
the next by optical flow (Lucas and Kanade 1981), fitted so that people, who move differently, do
not count (RANSAC, Fischler and Bolles 1981).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

CORNERS = 100  # that are followed
LEAST_CORNERS = 12  # fewer, as in fog or after a cut, do not tell how the camera moved
APART_PX = 8.0  # in a picture of half the size, where corners are looked for: a quarter of the time
QUALITY = 0.01  # of a corner, over that of the best one
NEIGHBOURHOOD_PX, HALVINGS = 13, 2  # of a corner; a movement of up to half of it, so often doubled
AGREE_PX = 1.0  # a corner that the fitted movement misses by more is of something that moved
LEAST_AGREEING = 0.4  # share of the corners; with fewer the scene was cut
FOLLOWED_PX = 640  # width at which corners are followed; larger pictures are shrunk for it


class FrameDifference:
    """Compares each picture with the one before it; a fixed camera's movement is not fitted."""

    def __init__(self, *, fixed: bool = False) -> None:
        self._fixed = fixed
        self._last: NDArray[np.uint8] | None = None

    def of(self, picture: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Brightness (h, w) of an RGB or grey picture minus that of the one before it, in levels.

        0 where that is not known: in the first picture, in one of another size, after a cut, and
        where the picture before did not reach.
        """
        # a copy of a grey picture: the room of a frame is used again
        grey = picture.copy() if picture.ndim == 2 else brightness(picture)
        last, self._last = self._last, grey
        if last is None or last.shape != grey.shape:
            return np.zeros(grey.shape, np.int16)
        before = last if self._fixed else registered(last, grey)
        if before is None:
            return np.zeros(grey.shape, np.int16)
        return np.asarray(cv2.subtract(grey, before, dtype=cv2.CV_16S), np.int16)

    def forget(self) -> None:
        """The next picture is of another stream."""
        self._last = None


def brightness(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Grey levels (h, w) of an RGB picture (h, w, 3)."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)


def registered(last: NDArray[np.uint8], grey: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """The picture before as the camera would show it now; where it did not reach, the one of now.

    None where the two pictures show different things.
    """
    matrix = camera_movement(last, grey)
    if matrix is None:
        return None
    size = grey.shape[1], grey.shape[0]
    moved = cv2.warpAffine(
        last, matrix, size, dst=grey.copy(), flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_TRANSPARENT,
    )  # fmt: skip
    return np.asarray(moved, np.uint8)


def camera_movement(last: NDArray[np.uint8], grey: NDArray[np.uint8]) -> NDArray[np.float64] | None:
    """The similarity (2, 3) that takes pixels of one grey picture to those of the next."""
    gain = min(1.0, FOLLOWED_PX / grey.shape[1])
    if gain < 1:
        size = FOLLOWED_PX, max(1, round(grey.shape[0] * gain))
        last, grey = (
            np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA), np.uint8)
            for p in (last, grey)
        )
    if min(grey.shape) < NEIGHBOURHOOD_PX:
        return None
    half = cv2.resize(last, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    corners = cv2.goodFeaturesToTrack(half, CORNERS, QUALITY, APART_PX)
    if corners is None or len(corners) < LEAST_CORNERS:
        return None
    corners = corners * 2 + 0.5
    found, known, _ = cv2.calcOpticalFlowPyrLK(
        last, grey, corners, None,  # type: ignore[call-overload]
        winSize=(NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX), maxLevel=HALVINGS,
    )  # fmt: skip
    kept = known[:, 0] > 0
    if kept.sum() < LEAST_CORNERS:
        return None
    matrix, agree = cv2.estimateAffinePartial2D(
        corners[kept], found[kept], ransacReprojThreshold=AGREE_PX
    )
    if matrix is None or agree.mean() < LEAST_AGREEING:
        return None
    matrix[:, 2] /= gain
    return np.asarray(matrix, np.float64)
