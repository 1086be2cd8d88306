"""Checkpoints of trainings: written atomically, readable on any device."""

import time
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import torch

from operators.training.identity import Identity, differing
from pipeline.errors import SettingsError, WeightsError
from pipeline.whole_file import write_whole

EVERY_S = 30.0  # a crash loses less than a minute, including repeated roll-outs


class Stateful(Protocol):
    """What networks and optimisers have in common."""

    def state_dict(self) -> dict[str, Any]:
        """All that must be kept."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> object:
        """Take it back, to the device where this part is."""


class Progress:
    """The state of a training (parts, steps, seconds, settings), stored in one file."""

    def __init__(self, out: Path, parts: Mapping[str, Stateful], identity: Identity) -> None:
        self.path, self.parts, self.identity = path_in(out), dict(parts), dict(identity)
        self.step, self.elapsed_s = 0, 0.0
        self._saved_s = time.monotonic()

    def save(self) -> None:
        """Write everything."""
        facts = {"step": self.step, "elapsed_s": self.elapsed_s, "settings": self.identity}
        parts = {name: part.state_dict() for name, part in self.parts.items()}
        whole = BytesIO()  # into a file on a full disk, torch raises no OSError but its own error
        torch.save(parts | facts, whole)
        write_whole(self.path, whole.getvalue())
        self._saved_s = time.monotonic()

    def save_when_due(self) -> None:
        """Write everything when the last time is long enough ago."""
        if time.monotonic() - self._saved_s > EVERY_S:
            self.save()

    def resume(self) -> None:
        """Resume from a checkpoint, if there is one; raises as `left` and `take` do."""
        if state := left(self.path, self.identity):
            take(self.path, self.parts, state)
            self.step, self.elapsed_s = state["step"], state["elapsed_s"]


def path_in(out: Path) -> Path:
    """Where a training keeps its checkpoint."""
    return out / "checkpoint.pt"


def left(path: Path, identity: Identity) -> Mapping[str, Any]:
    """Return a training's checkpoint, empty if none; raises `SettingsError` for another training.

    Otherwise its result would be mislabelled. Nor can steps be added, because the learning rate has
    already followed the original number of steps.
    """
    if not path.exists():
        return {}
    state = read(path)
    before = state.get("settings")
    if not isinstance(before, Mapping) or not {"step", "elapsed_s"} <= set(state):
        raise WeightsError(
            f"{path}: expected a checkpoint with its settings, got one of an earlier "
            "version; use another --out"
        )
    if other := differing(before, identity):
        told = (
            f"{name}: this folder's training has {before.get(name, 'none')}, "
            f"got {identity.get(name, 'none')}"
            for name in other
        )
        raise SettingsError(f"{'; '.join(told)}; use another --out, or remove {path}")
    return state


def take(path: Path, parts: Mapping[str, Stateful], state: Mapping[str, Any] | None = None) -> None:
    """Load parts from a checkpoint; raises `WeightsError` where they do not fit."""
    state = read(path) if state is None else state
    for name, part in parts.items():
        try:
            part.load_state_dict(state[name])
        except (KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path}: expected this training's {name}, got another's") from error


def check_parts(path: Path) -> None:
    """Raise `ValueError` for a file with a part that is damaged, which torch would load."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as parts:
            if damaged := parts.testzip():
                raise ValueError(f"a damaged part, {damaged}")


def read(path: Path) -> Mapping[str, Any]:
    """What `torch.save` wrote of a network or a training; raises `WeightsError` otherwise."""
    try:
        check_parts(path)
        # on the processor, wherever it was written: that device may not be here
        state = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch raises many kinds for what is no state dict
        reason = str(error).split("\n", 1)[0].split(". ", 1)[0] or "nothing"
        raise WeightsError(f"{path}: expected a state dict of tensors, got {reason}") from error
    if not isinstance(state, Mapping):
        raise WeightsError(f"{path}: expected a state dict of tensors, got {type(state).__name__}")
    return state
