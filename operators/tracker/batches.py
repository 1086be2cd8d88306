"""Batches of a tracker's training: files of pieces -> tensors on a device, new ones and reused.

Where processors make samples more slowly than a GPU learns from them, `reuses` steps after each new
batch take one of the last ones, mirrored, with other colours and noise.
"""

# mypy: disallow-subclassing-any=False
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from operators.tracker.data import batch
from operators.tracker.look import DEVIATION, MEAN
from operators.tracker.pieces import Pieces, load
from operators.tracker.training_settings import TrainSettings
from operators.training.device import moved
from operators.training.loading import in_sentences

REUSED_OF = 288_000  # the last new samples, of which one is reused: 19 GB where all are kept
RELIT, TINTED = 0.15, 0.05  # standard deviations of the logarithms of light and of colour
NOISE = 6.0  # largest standard deviation of noise, levels of 255
Batch = dict[str, Tensor]


class Batches(Dataset[Batch]):
    """Item n is the n-th new batch, which depends on the seed and n alone, not on the process.

    Each process reads the pieces itself, when it is asked for its first batch.
    """

    def __init__(self, files: list[Path], settings: TrainSettings) -> None:
        self._files, self._settings = files, settings
        self._pieces: Pieces | None = None

    def __getstate__(self) -> dict[str, object]:
        """What goes to another process: not the pieces, about 1 GB, which it reads itself."""
        return {**vars(self), "_pieces": None}

    def __getitem__(self, number: int) -> Batch:
        if self._pieces is None:
            self._pieces = load(self._files)
        s = self._settings
        drawn = batch(self._pieces, s.batch, np.random.default_rng([s.seed, 41, number]))
        return {name: torch.from_numpy(values) for name, values in drawn.items()}


def stream(
    source: Batches, steps: range, settings: TrainSettings, device: torch.device
) -> Iterator[Batch]:
    """The batches of some steps on a device, made by processes beside this one where it is a GPU.

    A step's batch is the same after an interruption, and whatever there is room for: one that is to
    be reused and was not kept is made once more.
    """
    if not steps:
        return
    period, most = settings.reuses + 1, max(1, REUSED_OF // settings.batch)
    workers = 0 if device.type == "cpu" else settings.threads
    loader = DataLoader(
        source,
        batch_size=None,
        sampler=range(-(-steps.start // period), -(-steps.stop // period)),
        num_workers=workers,
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=_alone if workers else None,
    )
    new, kept = in_sentences(loader), Kept(device, most)
    for step in steps:
        number, old = divmod(step, period)
        if not old:
            given = on(next(new), device)
            if settings.reuses:
                kept.put(number, given)
            yield given
            continue
        rng = np.random.default_rng([settings.seed, 42, step])
        number -= int(rng.integers(min(number + 1, most)))
        given = kept.batches.get(number) or on(source[number], device)
        kept.put(number, given)
        yield reused(given, int(rng.integers(2**31)))


class Kept:
    """The last `most` batches, as far as there is room for them on the device."""

    def __init__(self, device: torch.device, most: int) -> None:
        self.batches: dict[int, Batch] = {}
        self._room_bytes, self._most, self._newest = room_bytes(device), most, 0

    def put(self, number: int, given: Batch) -> None:
        """Keep a batch, and drop what is too old to be reused."""
        self._newest = max(self._newest, number)
        for old in [n for n in self.batches if n <= self._newest - self._most]:
            self._room_bytes += _size_bytes(self.batches.pop(old))
        if number <= self._newest - self._most or number in self.batches:
            return
        if _size_bytes(given) <= self._room_bytes:
            self.batches[number] = given
            self._room_bytes -= _size_bytes(given)


def room_bytes(device: torch.device) -> int:
    """What batches may take: half of a GPU's memory; nothing elsewhere, where making costs less."""
    return torch.cuda.mem_get_info(device)[1] // 2 if device.type == "cuda" else 0


def _size_bytes(given: Batch) -> int:
    return sum(values.nbytes for values in given.values())


def _alone(_: int) -> None:
    cv2.setNumThreads(1)  # there is a process for each core already


def on(given: Batch, device: torch.device) -> Batch:
    """The same on a device."""
    return {name: moved(values, device) for name, values in given.items()}


def reused(given: Batch, seed: int) -> Batch:
    """A batch once more, mirrored or not, with other light, colours and noise."""
    device, count = given["search"].device, len(given["search"])
    source = torch.Generator(device).manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(count, *shape, 1, 1, generator=source, device=device)

    found = dict(given)
    if seed % 2:
        for name in ("template", "search", "heat", "near", "place"):
            found[name] = given[name].flip(-1)
        sign = torch.tensor([1.0, 1.0, -1.0, 1.0], device=device)  # the offset to the right
        found["place"] = found["place"] * sign[:, None, None]
    gain = torch.exp(normal(1) * RELIT + normal(3) * TINTED)
    power = torch.exp(normal(1) * RELIT)
    for name in ("template", "search"):
        light = (found[name].float() / 255).pow(power) * gain * torch.exp(normal(1) * TINTED) * 255
        grain = torch.rand(count, 1, 1, 1, generator=source, device=device) * NOISE
        noise = torch.randn(light.shape, generator=source, device=device)
        found[name] = (light + noise * grain).round().clamp(0, 255).to(torch.uint8)
    return found


def normalised(pictures: Tensor) -> Tensor:
    """(n, 3, h, w) of 8 bit as the network takes them, like `look.normalise`, on any device."""
    mean = torch.from_numpy(MEAN).to(pictures.device)[:, None, None]
    deviation = torch.from_numpy(DEVIATION).to(pictures.device)[:, None, None]
    return (pictures.float() - mean) / deviation
