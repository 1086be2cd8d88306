"""What the detector learns from: one context picture and the objects in it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

PEOPLE = ("player", "referee")
BALL = "ball"
NAMES = (*PEOPLE, BALL)
ANYONE = len(NAMES)  # label of a person of whom it is not known which of `PEOPLE`
CONTEXT_PX = (480, 270)  # width, height of a quarter of full HD
DOMAIN = "soccer"  # the kind of scene that the classes are of
INPUT_PX = (480, 288)  # the same with sides that are multiples of 32
MULTIPLE_PX = 32  # of the sides of an input: the coarsest stride


def sides_of(width_px: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Width, height of a picture of the context's shape, and of the input that it lies in.

    >>> sides_of(480) == (CONTEXT_PX, INPUT_PX)
    True
    """
    height_px = round(width_px * CONTEXT_PX[1] / CONTEXT_PX[0])
    return (width_px, height_px), (width_px, -(-height_px // MULTIPLE_PX) * MULTIPLE_PX)


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One picture and what is in it."""

    picture: NDArray[np.uint8]  # (h, w, 3) RGB
    boxes: NDArray[np.float32]  # (n, 4) xyxy, its pixels
    labels: NDArray[np.int64]  # (n,) index into NAMES, or ANYONE
    ignored: NDArray[np.bool_]  # (n,) too hidden to count
    # (h, w) brightness minus that of the frame before, in levels; None: there is no frame before
    difference: NDArray[np.float32] | None = None


def resized(example: Example, size_px: tuple[int, int]) -> Example:
    """The example in another size: shrunk by area, as a sensor does it, or enlarged."""
    height, width = example.picture.shape[:2]
    if (width, height) == size_px:
        return example
    how = cv2.INTER_AREA if width > size_px[0] else cv2.INTER_LINEAR
    gain = np.array([size_px[0] / width, size_px[1] / height] * 2, np.float32)
    difference = example.difference
    if difference is not None:
        difference = np.asarray(cv2.resize(difference, size_px, interpolation=how), np.float32)
    return replace(
        example,
        picture=np.asarray(cv2.resize(example.picture, size_px, interpolation=how), np.uint8),
        boxes=example.boxes * gain,
        difference=difference,
    )
