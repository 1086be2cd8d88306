"""Photographs to hang drawn boards upon: file -> a part of it, and the texts that it has already.

Almost every photograph of a town or a stadium has texts, and nobody labelled them. PP-OCR finds
most of them; those may be found or not (Gupta et al., SynthText, 2016, left such pictures out).
"""

from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np

from operators.reader.ocr import PaddleOcr
from operators.saliency.text.streets import FULL_PX, Picture
from operators.training.splits import DEVELOPMENT, HELD_OUT, TEST
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest

SPLITS: dict[str, tuple[str, ...]] = {
    "training": (), "development": DEVELOPMENT, "held-out": TEST,
}  # fmt: skip
LEAST_SHARE = 0.4  # of the largest part of this shape
LEAST_PLACE = 0.3  # confidence of PP-OCR's detector: rather one text too many than one too few


def photographs_in(folder: Path, split: str = "training") -> list[Path]:
    """Return the photographs of one of `SPLITS`, by name; raises `DriverError` for none.

    Names that no list of `splits.py` has are for training.
    """
    kept = SPLITS[split]
    found = sorted(p for p in folder.glob("*.jpg") if p.name.startswith(HELD_OUT) == bool(kept))
    found = [path for path in found if not kept or path.name.startswith(kept)]
    if not found:
        raise DriverError(f"{folder}: expected photographs (.jpg) for {split}, got none")
    return found


def contents(files: Sequence[Path]) -> str:
    """What is in photographs, as a text that differs where they differ."""
    known = "".join(file.name + file_digest(file) for file in files)
    return f"{len(files)} files, {sha256(known.encode()).hexdigest()[:16]}"


def part_of(path: Path, rng: np.random.Generator) -> Picture:
    """Return a random part of a photograph, scaled to `FULL_PX`, and its texts as ignored ones."""
    read = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if read is None:
        raise DriverError(f"{path}: expected a picture, got none that can be read")
    height, width = read.shape[:2]
    share = rng.uniform(LEAST_SHARE, 1.0) * min(width / FULL_PX[0], height / FULL_PX[1])
    w, h = max(1, int(FULL_PX[0] * share)), max(1, int(FULL_PX[1] * share))
    x, y = int(rng.integers(width - w + 1)), int(rng.integers(height - h + 1))
    scaled = cv2.resize(read[y : y + h, x : x + w], FULL_PX, interpolation=cv2.INTER_AREA)
    pixels = np.asarray(scaled, np.uint8)
    quads = _finder().places(pixels)
    return Picture(pixels=pixels, quads=quads, ignored=np.ones(len(quads), np.bool_))


@cache
def _finder() -> PaddleOcr:
    return PaddleOcr(least_place=LEAST_PLACE)
