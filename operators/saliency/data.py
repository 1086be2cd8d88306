"""Training batches of rendered scenes and labelled stills, augmented differently each time."""

# mypy: disallow-subclassing-any=False
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from operators.saliency.augment import BALL_LABEL, augment
from operators.saliency.crops import augmented
from operators.saliency.example import CONTEXT_PX, Example, resized, sides_of
from operators.saliency.movement import KNOWN_SHARE
from operators.saliency.pasting import Bank
from operators.saliency.render import unpacked
from operators.saliency.stills import Stills
from operators.training.arrays import mapped, read
from operators.training.device import moved
from operators.training.loading import in_sentences
from pipeline.errors import DriverError

FILL = 114


@dataclass(frozen=True, kw_only=True)
class Batch:
    """B pictures and what is in them; rows past an item's own objects have label -1."""

    pictures: Tensor  # (B, 3, H, W) uint8 RGB, channels last in memory
    boxes: Tensor  # (B, M, 4) xyxy, input pixels
    labels: Tensor  # (B, M) index into NAMES, ANYONE, or -1: none
    ignored: Tensor  # (B, M) bool: too hidden to count
    # (B, 1, H, W) int8: half of the levels by which brightness changed; 0 where that is not known
    difference: Tensor

    def to(self, device: torch.device) -> "Batch":
        """The same on a device."""
        return Batch(**{name: moved(values, device) for name, values in vars(self).items()})

    def inputs(self, channels: int) -> Tensor:
        """What a network of 3 or 4 channels gets: RGB 0..1, and the difference -1..1."""
        pictures = self.pictures.float() / 255
        if channels == pictures.shape[1]:
            return pictures
        return torch.cat([pictures, self.difference.float() * (2 / 255)], 1)


class Rendered(Dataset[Example]):
    """The examples in files of `render`, as one endless stream.

    Item n depends only on the seed and the files, not on worker or order: each epoch is shuffled
    and augmented differently, and a resumed training continues exactly.
    """

    def __init__(self, files: Iterable[Path], *, seed: int, raw_share: float = 0.0) -> None:
        self._seed, self._raw_share = seed, raw_share
        self._scenes = [(mapped(path), read(path)) for path in files]
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
        plain = self.plain(int(self._order[step]))
        if rng.random() > KNOWN_SHARE:  # as the first picture of a stream
            plain = replace(plain, difference=None)
        return augment(plain, rng, self._raw_share)

    def plain(self, index: int) -> Example:
        """The picture as rendered."""
        scene, row = self._places[index]
        pictures, truth = self._scenes[scene]
        rows = slice(truth["first"][row], truth["first"][row + 1])
        picture, difference = unpacked(pictures[row])
        known = truth["known"][row] if "known" in truth else True
        return Example(
            picture=picture,
            difference=difference if known else None,
            boxes=truth["boxes"][rows],
            labels=truth["labels"][rows],
            ignored=truth["ignored"][rows],
        )


class Real(Dataset[Example]):
    """Crops of labelled stills, as one endless stream; item n depends on the seed and n alone.

    A folder of fewer stills has its turn more often than its number of stills would give it: by
    the square root. The stills are kept in memory, 6 MB each for full HD.
    """

    def __init__(
        self, folders: Iterable[Stills], *, seed: int, roi_share: float = 0.0,
        difference: bool = True,
    ) -> None:  # fmt: skip
        self._seed, self._folders = seed, tuple(folders)
        self._roi_share, self._difference = roi_share, difference
        counts = np.array([len(folder.files) for folder in self._folders], np.float64)
        self._turns = np.sqrt(counts) / np.sqrt(counts).sum()
        self._kept: dict[Path, Example] = {}

    def __len__(self) -> int:
        return sum(len(folder.files) for folder in self._folders)

    def __getitem__(self, number: int) -> Example:
        return self.sized(number, CONTEXT_PX)

    def sized(self, number: int, size_px: tuple[int, int]) -> Example:
        """Item `number` for a picture of this width and height."""
        rng = np.random.default_rng([self._seed, number, 1])
        folder = self._folders[rng.choice(len(self._folders), p=self._turns)]
        bank = Bank(count=len(folder.files), still=lambda index: self._still(folder, index))
        still = bank.still(int(rng.integers(bank.count)))
        roi = self._roi_share > 0 and rng.random() < self._roi_share
        example = augmented(still, bank, rng, size_px, roi=roi, difference=self._difference)
        # nothing says where the ball is that must be somewhere: no place counts as empty
        return example if (still.labels == BALL_LABEL).any() else without_ball(example)

    def __getstate__(self) -> dict[str, object]:
        """What goes to another process: not the pictures, which it reads itself."""
        return {**vars(self), "_kept": {}}

    def _still(self, folder: Stills, index: int) -> Example:
        file = folder.files[index]
        if file not in self._kept:
            self._kept[file] = folder.example(file)
        return self._kept[file]


def without_ball(example: Example) -> Example:
    """The example with a ball that may be found anywhere, or not at all."""
    height, width = example.picture.shape[:2]
    return replace(
        example,
        boxes=np.concatenate([example.boxes, np.array([[0, 0, width, height]], np.float32)]),
        labels=np.append(example.labels, BALL_LABEL),
        ignored=np.append(example.ignored, True),
    )


class Mixed(Dataset[Example]):
    """Item n is of `real` with probability `share`, of `drawn` otherwise.

    Pictures have `widths_px` in turn, `batch` items each: those of a batch have the same size.
    """

    def __init__(
        self, drawn: Rendered | None, real: Real | None, share: float, seed: int, *,
        widths_px: Sequence[int] = CONTEXT_PX[:1], batch: int = 1,
    ) -> None:  # fmt: skip
        if drawn is None and real is None:
            raise DriverError("data: expected rendered scenes or stills, got none")
        self._drawn, self._real, self._share, self._seed = drawn, real, share, seed
        self._sizes_px, self._batch = [sides_of(width)[0] for width in widths_px], batch

    def __len__(self) -> int:
        return sum(len(part) for part in (self._drawn, self._real) if part is not None)

    def __getitem__(self, number: int) -> Example:
        size_px = self._sizes_px[number // self._batch % len(self._sizes_px)]
        real = np.random.default_rng([self._seed, number, 2]).random() < self._share
        if self._drawn is not None and (self._real is None or not real):
            return resized(self._drawn[number], size_px)
        return self._real.sized(number, size_px)  # type: ignore[union-attr]


def rendered_in(folder: Path) -> list[Path]:
    """The files of a folder that `render` has finished."""
    return [path for path in sorted(folder.glob("*.npz")) if path.stem.isdigit()]


def collate(examples: list[Example]) -> Batch:
    """Place pictures of one size in an input and pad their object lists to equal length.

    The operator's letterbox does the same.
    """
    (_, high), (width, height) = sides_of(examples[0].picture.shape[1])
    top = (height - high) // 2
    count, most = len(examples), max(1, *(len(e.labels) for e in examples))
    pictures = np.full((count, height, width, 3), FILL, np.uint8)
    difference = np.zeros((count, 1, height, width), np.int8)
    boxes = np.zeros((count, most, 4), np.float32)
    labels = np.full((count, most), -1, np.int64)
    ignored = np.zeros((count, most), np.bool_)
    for row, item in enumerate(examples):
        n = len(item.labels)
        pictures[row, top : top + high] = item.picture
        if item.difference is not None:
            halves = np.clip(np.rint(item.difference / 2), -127, 127)
            difference[row, 0, top : top + high] = halves
        boxes[row, :n] = item.boxes + np.array([0, top, 0, top], np.float32)
        labels[row, :n], ignored[row, :n] = item.labels, item.ignored
    return Batch(
        pictures=torch.from_numpy(pictures).permute(0, 3, 1, 2),
        boxes=torch.from_numpy(boxes),
        labels=torch.from_numpy(labels),
        ignored=torch.from_numpy(ignored),
        difference=torch.from_numpy(difference),
    )


def one_thread(_: int) -> None:
    """Keep OpenCV to one thread in a process that prepares batches: each would use them all."""
    cv2.setNumThreads(1)


def stream(
    source: Dataset[Example], size: int, steps: range, *, workers: int = 1
) -> Iterator[Batch]:
    """The batches of some steps of a training, prepared by processes beside it."""
    loader = DataLoader(
        source,
        batch_size=size,
        sampler=range(steps.start * size, steps.stop * size),
        num_workers=workers,
        collate_fn=collate,
        prefetch_factor=6,
        worker_init_fn=one_thread,
        multiprocessing_context="spawn",
    )
    yield from in_sentences(loader)
