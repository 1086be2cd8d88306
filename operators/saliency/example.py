"""What the detector learns from: one context picture and the objects in it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PEOPLE = ("player", "referee")
BALL = "ball"
NAMES = (*PEOPLE, BALL)
ANYONE = len(NAMES)  # label of a person of whom it is not known which of `PEOPLE`
CONTEXT_PX = (480, 270)  # width, height of a quarter of full HD
DOMAIN = "soccer"  # the kind of scene that the classes are of
INPUT_PX = (480, 288)  # the same with sides that are multiples of 32


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One picture and what is in it."""

    picture: NDArray[np.uint8]  # (h, w, 3) RGB
    boxes: NDArray[np.float32]  # (n, 4) xyxy, its pixels
    labels: NDArray[np.int64]  # (n,) index into NAMES, or ANYONE
    ignored: NDArray[np.bool_]  # (n,) too hidden to count
