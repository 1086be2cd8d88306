"""Training batches of rendered scenes, augmented differently in each epoch."""

# mypy: disallow-subclassing-any=False
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from operators.saliency.augment import augment
from operators.saliency.example import CONTEXT_PX, INPUT_PX, Example
from operators.training.arrays import read
from operators.training.device import moved
from pipeline.errors import DriverError

TOP_PX = (INPUT_PX[1] - CONTEXT_PX[1]) // 2  # where the operator's letterbox puts the picture
FILL = 114


@dataclass(frozen=True, kw_only=True)
class Batch:
    """B pictures and what is in them; rows past an item's own objects have label -1."""

    pictures: Tensor  # (B, 3, H, W) uint8 RGB, channels last in memory
    boxes: Tensor  # (B, M, 4) xyxy, input pixels
    labels: Tensor  # (B, M) index into NAMES, -1: none
    ignored: Tensor  # (B, M) bool: too hidden to count

    def to(self, device: torch.device) -> "Batch":
        """The same on a device."""
        return Batch(**{name: moved(values, device) for name, values in vars(self).items()})


class Rendered(Dataset[Example]):
    """The examples in files of `render`, as one endless stream.

    Item n depends only on the seed and the files, not on worker or order: each epoch is shuffled
    and augmented differently, and a resumed training continues exactly.
    """

    def __init__(self, files: Iterable[Path], *, seed: int, raw_share: float = 0.0) -> None:
        self._seed, self._raw_share = seed, raw_share
        self._scenes = [(_pictures(path.with_suffix(".npy")), read(path)) for path in files]
        self._places = [
            (scene, row)
            for scene, (pictures, _) in enumerate(self._scenes)
            for row in range(len(pictures))
        ]
        if not self._places:
            raise DriverError("data: expected rendered scenes, got none")
        self._order = np.zeros(0, np.intp)
        self._epoch = -1

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Example:
        epoch, step = divmod(number, len(self))
        if epoch != self._epoch:
            self._order = np.random.default_rng([self._seed, epoch]).permutation(len(self))
            self._epoch = epoch
        rng = np.random.default_rng([self._seed, epoch, step])
        return augment(self.plain(int(self._order[step])), rng, self._raw_share)

    def plain(self, index: int) -> Example:
        """The picture as rendered."""
        scene, row = self._places[index]
        pictures, truth = self._scenes[scene]
        rows = slice(truth["first"][row], truth["first"][row + 1])
        return Example(
            picture=np.array(pictures[row]),
            boxes=truth["boxes"][rows],
            labels=truth["labels"][rows],
            ignored=truth["ignored"][rows],
        )


def rendered_in(folder: Path) -> list[Path]:
    """The files of a folder that `render` has finished."""
    return [path for path in sorted(folder.glob("*.npz")) if path.stem.isdigit()]


def _pictures(path: Path) -> NDArray[np.uint8]:
    try:
        return np.load(path, mmap_mode="r")  # type: ignore[no-any-return]
    except (OSError, EOFError, ValueError) as error:
        raise DriverError(f"{path}: expected pictures, got {error}") from error


def collate(examples: list[Example]) -> Batch:
    """Place context pictures in the network's input and pad their object lists to equal length."""
    count, most = len(examples), max(1, *(len(e.labels) for e in examples))
    pictures = np.full((count, INPUT_PX[1], INPUT_PX[0], 3), FILL, np.uint8)
    boxes = np.zeros((count, most, 4), np.float32)
    labels = np.full((count, most), -1, np.int64)
    ignored = np.zeros((count, most), np.bool_)
    for row, item in enumerate(examples):
        n = len(item.labels)
        pictures[row, TOP_PX : TOP_PX + CONTEXT_PX[1]] = item.picture
        boxes[row, :n] = item.boxes + np.array([0, TOP_PX, 0, TOP_PX], np.float32)
        labels[row, :n], ignored[row, :n] = item.labels, item.ignored
    return Batch(
        pictures=torch.from_numpy(pictures).permute(0, 3, 1, 2),
        boxes=torch.from_numpy(boxes),
        labels=torch.from_numpy(labels),
        ignored=torch.from_numpy(ignored),
    )


def stream(
    files: Iterable[Path], size: int, steps: range, *, seed: int, workers: int = 1,
    raw_share: float = 0.0,
) -> Iterator[Batch]:  # fmt: skip
    """The batches of some steps of a training, prepared by processes beside it."""
    loader = DataLoader(
        Rendered(files, seed=seed, raw_share=raw_share),
        batch_size=size,
        sampler=range(steps.start * size, steps.stop * size),
        num_workers=workers,
        collate_fn=collate,
        prefetch_factor=6,
        multiprocessing_context="spawn",
    )
    yield from loader
