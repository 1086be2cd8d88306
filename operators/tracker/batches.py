"""Batches of a tracker's training: files of pieces -> tensors on a device, new ones and old again.

A processor makes samples more slowly than a GPU learns from them. `again` steps after each new
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

KEPT = 288_000  # samples to choose from: 18 GB of a GPU
RELIT, TINTED, NOISE = 0.15, 0.05, 6.0  # deviations of logarithms; levels at most
Given = dict[str, Tensor]


class Batches(Dataset[Given]):
    """Item n is the n-th new batch, which depends on the seed and n alone, not on the process.

    Each process reads the pieces itself, when it is asked for its first batch.
    """

    def __init__(self, files: list[Path], settings: TrainSettings) -> None:
        self._files, self._settings = files, settings
        self._pieces: Pieces | None = None

    def __getitem__(self, number: int) -> Given:
        if self._pieces is None:
            self._pieces = load(self._files)
        s = self._settings
        drawn = batch(self._pieces, s.batch, np.random.default_rng([s.seed, 41, number]))
        return {name: torch.from_numpy(values) for name, values in drawn.items()}


def stream(
    source: Batches, steps: range, settings: TrainSettings, device: torch.device
) -> Iterator[Given]:
    """The batches of some steps on a device, made by processes beside this one where it is a GPU.

    A step's batch is the same after an interruption: one that is to be used again and is not kept
    any more is made anew.
    """
    period, most = settings.again + 1, max(1, KEPT // settings.batch)
    workers = 0 if device.type == "cpu" else settings.threads
    loader = DataLoader(
        source,
        batch_size=None,
        sampler=range(-(-steps.start // period), -(-steps.stop // period)),
        num_workers=workers,
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=_alone if workers else None,
    )
    new, kept = iter(loader), dict[int, Given]()
    for step in steps:
        number, old = divmod(step, period)
        if not old:
            given = on(next(new), device)
            if settings.again:
                kept[number] = given
                kept.pop(number - most, None)
            yield given
            continue
        rng = np.random.default_rng([settings.seed, 42, step])
        number -= int(rng.integers(min(number + 1, most)))
        given = kept.get(number) or on(source[number], device)
        yield again(given, int(rng.integers(2**31)))


def _alone(_: int) -> None:
    cv2.setNumThreads(1)  # there is a process for each core already


def on(given: Given, device: torch.device) -> Given:
    """The same on a device."""
    return {name: moved(values, device) for name, values in given.items()}


def again(given: Given, seed: int) -> Given:
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
        found[name] = (light + noise * grain).clamp(0, 255).to(torch.uint8)
    return found


def normalised(pictures: Tensor) -> Tensor:
    """(n, 3, h, w) of 8 bit as the network takes them, like `look.normalise`, on any device."""
    mean, deviation = (
        torch.from_numpy(values).to(pictures.device)[:, None, None] for values in (MEAN, DEVIATION)
    )
    return (pictures.float() - mean) / deviation
