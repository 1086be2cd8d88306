"""Inference of the learned policy: candidates and a condition -> probability per candidate."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from operators.policy.conditioning import CONDITION
from operators.policy.tokens import BOX, CLASSES, Array, Objects, batched
from pipeline import Tracks
from pipeline.errors import MessageError, WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO
from pipeline.weights import weights_file

SHIPPED = Path(__file__).with_name("policy.onnx")
LONG_HORIZON = Path(__file__).with_name("policy_long_horizon.onnx")  # To 10, Tp 200
NAMED = {"": SHIPPED, "long_horizon": LONG_HORIZON}


class PolicyNetwork:
    """The network of one ONNX file; raises `WeightsError` unless it is a policy network."""

    def __init__(
        self, path: Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        if path in NAMED.values() and not path.is_file():
            raise WeightsError(f"policy.weights: {path.name} is not there; train one, or name one")
        self.path = path
        self.network = Network(path, threads=threads, provider=provider, device=device)
        given = self.network.inputs
        wanted = {f.name for f in fields(Objects)} - {"ids", "path"} | {"condition", "mask"}
        if set(given) != wanted or set(self.network.outputs) != {"logits"}:
            raise WeightsError(
                f"{path}: expected a policy's inputs {', '.join(sorted(wanted))} and the output "
                f"logits, got {', '.join(given)} and {', '.join(self.network.outputs)}"
            )
        self.roi_channels, self.context_channels = _last(given["roi"]), _last(given["context"])
        self.observed, self.horizon = _last(given["boxes"][:-1]), _last(given["predicted"][:-1])
        for name, sides in {
            "roi": [self.observed, self.roi_channels],
            "context": [self.observed, self.context_channels],
            "boxes": [self.observed, BOX + 1],
            "predicted": [self.horizon, BOX],
            "label": [CLASSES],
            "condition": [CONDITION],
        }.items():
            got = list(given[name])[-len(sides) :]
            if got != sides:
                raise WeightsError(f"{path}: expected {name} of {sides}, got {got}")

    def suits(self, *, horizon: int, observed: int) -> None:
        """Raise `WeightsError` unless the network was trained for these settings."""
        if (self.horizon, self.observed) != (horizon, observed):
            raise WeightsError(
                f"{self.path}: expected horizon {horizon} and observed {observed} as policy's "
                f"settings say, got {self.horizon} and {self.observed}"
            )

    def check(self, tracks: Tracks) -> None:
        """Raise `MessageError` unless the tracks are what the network was trained on."""
        expected = (self.observed, self.context_channels, self.horizon)
        got = (*tracks.features.shape[1:], tracks.predicted.shape[1])
        if len(tracks.ids) and expected != got:
            raise MessageError(
                f"policy.tracks: {self.path.name} expects {expected[0]} frames of {expected[1]} "
                f"features and {expected[2]} foreseen, got {got[0]} of {got[1]} and {got[2]}"
            )

    def __call__(self, candidates: Objects, condition: Array) -> Array:
        """Probability of each of N candidates at each step: (N, Tp)."""
        logits = self.network(batched([candidates], [condition]))["logits"][0]
        return softmax(logits)


def file_of(weights: str) -> Path:
    """Return the file that a setting `weights` means: a shipped one by name, else a path."""
    return weights_file(weights, NAMED)


def _last(sides: Sequence[object]) -> int:
    """The last side, 0 where it is open."""
    side = sides[-1] if sides else 0
    return side if isinstance(side, int) else 0


def softmax(logits: Array) -> Array:
    """Over the candidates: (..., N, Tp) -> the same, each step's sum 1."""
    raised = np.exp(logits - logits.max(-2, keepdims=True, initial=-np.inf))
    return np.asarray(raised / raised.sum(-2, keepdims=True), np.float32)
