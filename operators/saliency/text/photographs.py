"""Photographs to hang drawn boards upon: file -> a part of it, and the texts that it has already.

Almost every photograph of a town or a stadium has texts, and nobody labelled them. PP-OCR finds
most of them; those may be found or not (Gupta et al., SynthText, 2016, left such pictures out).
"""

from collections.abc import Iterator, Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import read_picture
from drivers.datasets.texts.labels import ILLEGIBLE, labels_beside
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
    read = read_picture(path)
    height, width = read.shape[:2]
    share = rng.uniform(LEAST_SHARE, 1.0) * min(width / FULL_PX[0], height / FULL_PX[1])
    w, h = max(1, int(FULL_PX[0] * share)), max(1, int(FULL_PX[1] * share))
    x, y = int(rng.integers(width - w + 1)), int(rng.integers(height - h + 1))
    scaled = cv2.resize(read[y : y + h, x : x + w], FULL_PX, interpolation=cv2.INTER_AREA)
    pixels = np.asarray(scaled, np.uint8)
    quads = _finder().places(pixels)
    return Picture(pixels=pixels, quads=quads, ignored=np.ones(len(quads), np.bool_))


def labelled_in(folder: Path) -> Iterator[Picture]:
    """Yield the photographs of a folder that have labels, scaled to `FULL_PX`, with their words.

    Labels as `drivers/datasets/texts` reads them; a word that they call illegible may be found
    or not. Raises `DriverError` for a folder without any, and with file and line for a wrong one.
    """
    found = 0
    for path in sorted(folder.glob("*.jpg")):
        labels = labels_beside(path)
        if labels is None:
            continue
        found += 1
        read = read_picture(path)
        gain = np.array(FULL_PX, np.float32) / np.array(read.shape[1::-1], np.float32)
        quads = [_quad(label.outline) * gain for label in labels]
        yield Picture(
            pixels=np.asarray(cv2.resize(read, FULL_PX, interpolation=cv2.INTER_AREA), np.uint8),
            quads=np.array(quads, np.float32).reshape(-1, 4, 2),
            ignored=np.array([label.text == ILLEGIBLE for label in labels], np.bool_),
        )
    if not found:
        raise DriverError(f"{folder}: expected photographs (.jpg) with labels, got none")


def _quad(outline: NDArray[np.float32]) -> NDArray[np.float32]:
    """The corners of a text: its own four, or those of the smallest rectangle around it."""
    if len(outline) == 4:
        return outline
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(outline)), np.float32)


@cache
def _finder() -> PaddleOcr:
    return PaddleOcr(least_place=LEAST_PLACE)
