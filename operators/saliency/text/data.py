"""Training batches of drawn pictures with words, augmented differently each time."""

# mypy: disallow-subclassing-any=False
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from operators.saliency.text.anchors import candidates, centres, uncounted
from operators.saliency.text.examples import INPUT_PX, KEPT_PX
from operators.saliency.text.quads import areas, turned
from operators.saliency.text.streets import Picture
from operators.training.arrays import mapped, read
from operators.training.device import moved
from operators.training.loading import in_sentences
from operators.training.photometric import degrade, recolour
from pipeline.errors import DriverError

FILL = 114
LEAST_HEIGHT_PX = 1.3  # of a word that must be found
ANCHORS = centres(*INPUT_PX)


@dataclass(frozen=True, kw_only=True)
class Batch:
    """B pictures and their G words."""

    pictures: Tensor  # (B, 3, H, W) uint8 RGB, channels last in memory
    boxes: Tensor  # (G, 5) turned, input pixels
    item: Tensor  # (G,) picture of each word
    candidates: Tensor  # (G, MOST) anchors that may find it, -1: none
    counts: Tensor  # (B, A) bool: False where something may be found or not

    def to(self, device: torch.device) -> "Batch":
        """The same on a device."""
        return Batch(**{name: moved(values, device) for name, values in vars(self).items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One input of the network and what is to be found in it."""

    pixels: NDArray[np.uint8]  # (H, W, 3) of `INPUT_PX`
    boxes: NDArray[np.float32]  # (n, 5) turned, its pixels
    candidates: NDArray[np.int64]  # (n, MOST)
    counts: NDArray[np.bool_]  # (A,)


class Words(Dataset[Example]):
    """Kept pictures of several folders as one endless stream.

    Item n depends on the seed and the files alone: a resumed training continues exactly. Each
    folder has its share of the items, however many pictures it has.
    """

    def __init__(
        self, folders: Sequence[Sequence[Path]], shares: Sequence[float], seed: int
    ) -> None:
        if not folders or not all(folders):
            raise DriverError("data: expected pictures in every folder, got none in one")
        self._files, self._seed = [list(files) for files in folders], seed
        self._shares = np.array(shares, np.float64) / sum(shares)
        self._open: dict[Path, tuple[NDArray[np.uint8], dict[str, NDArray[np.generic]]]] = {}

    def __len__(self) -> int:
        return sum(len(files) for files in self._files)

    def __getitem__(self, number: int) -> Example:
        rng = np.random.default_rng([self._seed, number])
        files = self._files[int(rng.choice(len(self._files), p=self._shares))]
        path = files[int(rng.integers(len(files)))]
        return example(augment(self._picture(path, rng), rng))

    def __getstate__(self) -> dict[str, object]:
        """What goes to another process: not the open files."""
        return {**vars(self), "_open": {}}

    def _picture(self, path: Path, rng: np.random.Generator) -> Picture:
        if path not in self._open:
            self._open[path] = mapped(path), dict(read(path))
        pictures, truth = self._open[path]
        row = int(rng.integers(len(pictures)))
        first = truth["first"]
        rows = slice(int(first[row]), int(first[row + 1]))
        return Picture(
            pixels=np.array(pictures[row]),
            quads=np.asarray(truth["quads"][rows], np.float32),
            ignored=np.asarray(truth["ignored"][rows], np.bool_),
        )


def augment(picture: Picture, rng: np.random.Generator) -> Picture:
    """Cut a part and shrink it to `INPUT_PX`, then change its light, sharpness and noise."""
    share = 1.0 if rng.random() < 0.45 else float(np.exp(rng.uniform(np.log(0.45), 0)))
    w, h = KEPT_PX[0] * share, KEPT_PX[0] * share * INPUT_PX[1] / INPUT_PX[0]
    # a little higher than what is kept where all of it is shown: what is missing is grey
    x = rng.uniform(0, KEPT_PX[0] - w)
    y = (KEPT_PX[1] - h) / 2 if h > KEPT_PX[1] else rng.uniform(0, KEPT_PX[1] - h)
    gain = INPUT_PX[0] / w
    matrix = np.array([[gain, 0, -x * gain], [0, gain, -y * gain]], np.float32)
    pixels = _shrunk(picture.pixels, matrix, gain)
    pixels = degrade(_weather(recolour(pixels, rng), rng), rng)
    quads = (picture.quads - np.array([x, y], np.float32)) * np.float32(gain)
    bar = math.ceil((h - KEPT_PX[1]) / 2 * gain)
    if bar > 0:  # no higher than what is missing: words beside it are to be found
        pixels[:bar], pixels[-bar:] = FILL, FILL
    return Picture(pixels=pixels, quads=quads, ignored=picture.ignored)


def _shrunk(
    pixels: NDArray[np.uint8], matrix: NDArray[np.float32], gain: float
) -> NDArray[np.uint8]:
    """Sample a picture at `INPUT_PX`; a reduction averages, as a sensor's does."""
    fine = 2 if gain < 0.75 else 1
    size = (INPUT_PX[0] * fine, INPUT_PX[1] * fine)
    half = np.float32(0.5)
    # centres of pixels lie at halves
    shift = matrix[:, 2] * fine + (matrix[[0, 1], [0, 1]] * fine - 1) * half
    scaled = np.concatenate([matrix[:, :2] * fine, shift[:, None]], 1)
    fill = (FILL,) * 3
    seen = cv2.warpAffine(pixels, scaled, size, flags=cv2.INTER_LINEAR, borderValue=fill)
    if fine > 1:
        seen = cv2.resize(seen, INPUT_PX, interpolation=cv2.INTER_AREA)
    return np.asarray(seen, np.uint8)


def _weather(pixels: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Dusk, fog, and blur by motion; each only sometimes."""
    draw = rng.random()
    if draw < 0.15:
        pixels = cv2.convertScaleAbs(pixels, alpha=rng.uniform(0.2, 0.7))  # type: ignore[assignment]
    elif draw < 0.25:
        grey, share = float(rng.uniform(90, 220)), rng.uniform(0.2, 0.6)
        pixels = cv2.convertScaleAbs(pixels, alpha=1 - share, beta=grey * share)  # type: ignore[assignment]
    if rng.random() < 0.15:
        length = int(rng.integers(2, 5))
        kernel = np.zeros((5, 5), np.float32)
        cv2.line(kernel, (2, 2), (2 + int(rng.integers(-1, 2)), 2 + length // 2), 1.0)
        kernel = kernel if rng.random() < 0.3 else kernel.T
        pixels = cv2.filter2D(pixels, -1, kernel / kernel.sum())  # type: ignore[assignment]
    return np.asarray(pixels, np.uint8)


def example(picture: Picture) -> Example:
    """Return a picture of `INPUT_PX` with the anchors that may find its words.

    Words cut in two by the picture's border, or too small, may be found or not.
    """
    width, height = INPUT_PX
    boxes = turned(picture.quads)
    inner = np.clip(picture.quads, 0, np.array([width, height], np.float32))
    share = areas(inner) / np.maximum(areas(picture.quads), 1e-6)
    there = share > 0.02
    hazy = picture.ignored | (share < 0.7) | (boxes[:, 3] < LEAST_HEIGHT_PX) | (boxes[:, 2] < 2)
    wanted = boxes[there & ~hazy]
    return Example(
        pixels=picture.pixels,
        boxes=wanted,
        candidates=candidates(wanted, ANCHORS),
        counts=~uncounted(boxes[there & hazy], ANCHORS),
    )


def collate(examples: list[Example]) -> Batch:
    """Stack examples."""
    counts = [len(e.boxes) for e in examples]
    return Batch(
        pictures=torch.from_numpy(np.stack([e.pixels for e in examples])).permute(0, 3, 1, 2),
        boxes=torch.from_numpy(np.concatenate([e.boxes for e in examples])),
        item=torch.from_numpy(np.repeat(np.arange(len(examples)), counts)),
        candidates=torch.from_numpy(np.concatenate([e.candidates for e in examples])),
        counts=torch.from_numpy(np.stack([e.counts for e in examples])),
    )


def stream(source: Words, size: int, steps: range, *, workers: int = 1) -> Iterator[Batch]:
    """The batches of some steps of a training, prepared by processes beside it."""
    loader = DataLoader(
        source,
        batch_size=size,
        sampler=range(steps.start * size, steps.stop * size),
        num_workers=workers,
        collate_fn=collate,
        prefetch_factor=6,
        multiprocessing_context="spawn",
    )
    yield from in_sentences(loader)
