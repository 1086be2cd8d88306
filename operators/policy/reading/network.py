"""Inference of the learned policy that reads: candidates -> probability per candidate."""

from pathlib import Path

from operators.policy.network import softmax
from operators.policy.reading.tokens import CONDITION, DEAF, ENCODED, LOOKS, Texts, batched
from operators.policy.tokens import BOX, Array
from pipeline import Tracks
from pipeline.errors import MessageError, WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO

SHIPPED = Path(__file__).with_name("reading.onnx")
INPUTS = {*ENCODED, "condition", "mask"}


class ReadingNetwork:
    """The network of one ONNX file; raises `WeightsError` unless it is one of these."""

    def __init__(
        self, path: Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        if path == SHIPPED and not path.is_file():
            raise WeightsError(f"policy.weights: {path.name} is not there; train one, or name one")
        self.path = path
        self.network = Network(path, threads=threads, provider=provider, device=device)
        given = self.network.inputs
        if set(given) != INPUTS or set(self.network.outputs) != {"logits"}:
            raise WeightsError(
                f"{path}: expected a reading policy's inputs {', '.join(sorted(INPUTS))} and the "
                f"output logits, got {', '.join(given)} and {', '.join(self.network.outputs)}"
            )
        sides = {name: [s if isinstance(s, int) else 0 for s in given[name]] for name in given}
        self.roi_channels, self.context_channels = sides["roi"][-1], sides["context"][-1]
        self.observed, self.horizon = sides["boxes"][-2], sides["predicted"][-2]
        for name, wanted in {
            "roi": [self.observed, self.roi_channels],
            "context": [self.observed, self.context_channels],
            "boxes": [self.observed, BOX + 1],
            "predicted": [self.horizon, BOX],
            "looks": [LOOKS],
            "rule": [self.horizon],
            "condition": [CONDITION],
        }.items():
            got = sides[name][-len(wanted) :]
            if got != wanted or not all(wanted):
                raise WeightsError(f"{path}: expected {name} of {wanted}, got {got}")

    def sure(self, asked: float) -> float:
        """Return the score from which a text counts as read; above all where it heeds no reader."""
        return asked if "feedback" in self.network.metadata.get("use", "feedback") else DEAF

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

    def __call__(self, candidates: Texts, condition: Array) -> Array:
        """Probability of each of N candidates at each step: (N, Tp)."""
        logits = self.network(batched([candidates], [condition]))["logits"][0]
        return softmax(logits)
