"""The learned policy: tracks, looks and a prompt -> a plan (paper, section 3.5).

`observe` and `decide` are the same for the live graph and for training's roll-outs; only who
computes the probabilities between them differs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from operators.policy.conditioning import CONDITION, encode_condition, encode_place, unlike
from operators.policy.gaze_plan import GazePlan, field_centre, stay
from operators.policy.memory import Memory, recall, refuted
from operators.policy.target import Choice, TargetSpec, TargetState, carrier_row, follow
from operators.policy.tokens import (
    BOX,
    CLASSES,
    Array,
    Objects,
    batched,
    encode_objects,
    joined,
    without,
)
from pipeline import Tracks
from pipeline.errors import MessageError, WeightsError
from pipeline.inference import Network

SHIPPED = Path(__file__).with_name("policy.onnx")
Selection = Literal["argmax", "sample"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Gaze:
    """What the learned policy remembers beside its looks."""

    target: TargetState = field(default_factory=TargetState)
    first_seq: int = 0  # the frame that row 0 of the last choice speaks of
    choice: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))  # (Tp,)
    chance: Array = field(default_factory=lambda: np.zeros(0, np.float32))  # (Tp,)


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What a graph sets of it."""

    patience: int = 64  # frames for which the place of a target out of sight stays a candidate
    least_genuine: float = 0.2
    roi_channels: int = 576
    loyalty: float = 30.0  # how much likelier the target's own track is; 1: no more so


class PolicyNetwork:
    """The network of one ONNX file; raises `WeightsError` when it is none of ours."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        if path == SHIPPED and not path.is_file():
            raise WeightsError(f"policy.weights: {path.name} is not there; train one, or name one")
        self.path, self._network = path, Network(path, threads=threads)
        given = self._network.inputs
        wanted = {f.name for f in fields(Objects)} - {"ids", "path"} | {"condition", "mask"}
        if set(given) != wanted or set(self._network.outputs) != {"logits"}:
            raise WeightsError(
                f"{path}: expected a policy's inputs {', '.join(sorted(wanted))} and the output "
                f"logits, got {', '.join(given)} and {', '.join(self._network.outputs)}"
            )
        self.roi_channels, self._context = _last(given["roi"]), _last(given["context"])
        self.observed, self.horizon = _last(given["boxes"][:-1]), _last(given["predicted"][:-1])
        for name, sides in {
            "roi": [self.observed, self.roi_channels],
            "context": [self.observed, self._context],
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
        expected = (self.observed, self._context, self.horizon)
        got = (*tracks.features.shape[1:], tracks.predicted.shape[1])
        if len(tracks.ids) and expected != got:
            raise MessageError(
                f"policy.tracks: {self.path.name} expects {expected[0]} frames of {expected[1]} "
                f"features and {expected[2]} foreseen, got {got[0]} of {got[1]} and {got[2]}"
            )

    def __call__(self, candidates: Objects, condition: Array) -> Array:
        """Probability of each of N candidates at each step: (N, Tp)."""
        logits = self._network(batched([candidates], [condition]))["logits"][0]
        return softmax(logits)


def _last(sides: Sequence[object]) -> int:
    """The last side, 0 where it is open."""
    side = sides[-1] if sides else 0
    return side if isinstance(side, int) else 0


def softmax(logits: Array) -> Array:
    """Over the candidates: (..., N, Tp) -> the same, each step's sum 1."""
    raised = np.exp(logits - logits.max(-2, keepdims=True, initial=-np.inf))
    return np.asarray(raised / raised.sum(-2, keepdims=True), np.float32)


def observe(
    before: Gaze, spec: TargetSpec, tracks: Tracks, memory: Memory, rules: Rules
) -> tuple[Gaze, Objects, Array]:
    """Take in one frame: what to remember, the candidates, the condition."""
    seq, observed = tracks.header.seq, tracks.boxes.shape[1]
    target = follow(before.target, spec, tracks, chosen_for(before, seq))
    ids = np.append(tracks.ids, np.int32(target.bound_id))
    looks = recall(memory, ids, seq=seq, observed=observed, channels=rules.roi_channels)
    candidates = encode_objects(tracks, looks[:-1])
    candidates = without(candidates, refuted(memory, candidates.ids, rules.least_genuine))
    if carrier_row(target, tracks) >= 0:  # where it was going before is nowhere
        candidates = without(candidates, candidates.ids == target.bound_id)
    spot = encode_place(target, spec, tracks, looks[-1], patience=rules.patience)
    if spot is not None:
        candidates = joined(candidates, spot)
        candidates = without(candidates, unlike(target, spec, tracks, candidates.ids))
    return replace(before, target=target), candidates, encode_condition(target, spec, tracks)


def loyal(probability: Array, candidates: Objects, target: TargetState, loyalty: float) -> Array:
    """The network's belief (N, Tp) times the target's own; each step's sum is 1 again.

    The target is followed by motion, the network knows it by its looks and its place. Among
    players of one team looks tell little: who was meant a moment ago is still meant, unless the
    network is `loyalty` times surer of somebody else.
    """
    own = candidates.ids == target.bound_id
    if target.bound_id < 0 or not own.any():
        return probability
    raised = np.where(own[:, None], loyalty, np.float32(1)) * probability
    return np.asarray(raised / raised.sum(0, keepdims=True), np.float32)


def fault(tracks: Tracks) -> str:
    """A sentence when the tracks hold something that is no number, else empty."""
    if all(np.isfinite(a).all() for a in (tracks.features, tracks.boxes, tracks.predicted)):
        return ""
    return f"policy.tracks: expected finite numbers in frame {tracks.header.seq}, got others"


def chosen_for(gaze: Gaze, seq: int) -> Choice:
    """What the last plan had chosen for frame `seq`; nothing past its end."""
    row = seq - gaze.first_seq
    if not 0 <= row < len(gaze.choice):
        return Choice()
    return Choice(object_id=int(gaze.choice[row]), probability=float(gaze.chance[row]))


def decide(
    before: Gaze, tracks: Tracks, candidates: Objects, probability: Array, picked: NDArray[np.intp]
) -> tuple[GazePlan, Gaze]:
    """The plan that looks at candidate `picked[t]` (Tp,) at step t, and what to remember of it."""
    steps = np.arange(len(picked))
    choice = candidates.ids[picked]
    over = np.zeros((len(picked), len(tracks.ids)), np.float32)
    track, candidate = np.nonzero(tracks.ids[:, None] == candidates.ids)
    over[:, track] = probability[candidate].T
    plan = GazePlan(choice=choice, boxes=candidates.path[picked, steps], probability=over)
    return plan, replace(
        before,
        first_seq=tracks.header.seq + 1,
        choice=choice,
        chance=probability[picked, steps],
    )


def pick(probability: Array, how: Selection, rng: np.random.Generator) -> NDArray[np.intp]:
    """One candidate for each step: (N, Tp) -> (Tp,)."""
    if how == "argmax":
        return np.asarray(probability.argmax(0))
    reached = probability.cumsum(0) >= rng.random(probability.shape[1]) * probability.sum(0)
    return np.asarray(reached.argmax(0))


def nothing(gaze: Gaze, tracks: Tracks, horizon: int) -> GazePlan:
    """Without candidates: where the target was last believed to be, or the middle of the field."""
    if gaze.target.placed:
        return stay(gaze.target.box, horizon)
    return stay(field_centre(tracks.header.geometry), horizon)
