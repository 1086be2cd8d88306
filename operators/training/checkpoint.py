"""A training on disk: written whole or not at all, read for whatever device goes on with it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch

from pipeline.errors import WeightsError


class Stateful(Protocol):
    """What networks and optimisers have in common."""

    def state_dict(self) -> dict[str, Any]:
        """All that must be kept."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> object:
        """Take it back, to the device where this part is."""


class Progress:
    """How far a training has come: its parts, steps and seconds, all in one file."""

    def __init__(self, out: Path, parts: Mapping[str, Stateful]) -> None:
        self.path, self.parts = out / "checkpoint.pt", dict(parts)
        self.step, self.elapsed_s = 0, 0.0

    def save(self, **facts: object) -> None:
        """Write everything, and these facts."""
        save(self.path, self.parts, step=self.step, elapsed_s=self.elapsed_s, **facts)

    def resume(self) -> Mapping[str, Any]:
        """Go on where a checkpoint stopped, if there is one; returns all that was saved."""
        state = resume(self.path, self.parts)
        self.step = state.get("step", self.step)
        self.elapsed_s = state.get("elapsed_s", self.elapsed_s)
        return state


def save(path: Path, parts: Mapping[str, Stateful], **facts: object) -> None:
    """Write the parts' states and the facts under their names, atomically."""
    unfinished = path.with_suffix(".part")
    torch.save({name: part.state_dict() for name, part in parts.items()} | facts, unfinished)
    unfinished.rename(path)


def resume(path: Path, parts: Mapping[str, Stateful]) -> Mapping[str, Any]:
    """Give the parts their states back; returns all that was saved, empty where nothing was."""
    if not path.exists():
        return {}
    state = read(path)
    for name, part in parts.items():
        part.load_state_dict(state[name])
    return state


def read(path: Path) -> Mapping[str, Any]:
    """What `torch.save` wrote of a network or a training; raises `WeightsError` otherwise."""
    try:
        # on the processor, wherever it was written: that device may not be here
        state = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch raises many kinds for what is no state dict
        reason = str(error).split("\n", 1)[0]
        raise WeightsError(f"{path}: expected a state dict of tensors, got {reason}") from error
    if not isinstance(state, Mapping):
        raise WeightsError(f"{path}: expected a state dict of tensors, got {type(state).__name__}")
    return state
