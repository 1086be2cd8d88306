"""Decisions of the learned policy: tracks, ROI features and a prompt -> a plan (section 3.5).

The live graph and the roll-outs of the training share `observe` and `decide`; only the batch size
of the network differs.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from operators.policy.conditioning import encode_condition, encode_place, unlike
from operators.policy.gaze_plan import GazePlan, field_centre, of_class, stay
from operators.policy.memory import Memory, blank, recall
from operators.policy.target import Choice, TargetSpec, TargetState, carrier_row, follow
from operators.policy.tokens import Array, Objects, encode_objects, joined, without
from pipeline import Tracks

Selection = Literal["argmax", "sample"]


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyState:
    """State of the learned policy between frames; immutable."""

    spec: TargetSpec = field(default_factory=TargetSpec)  # the target that was asked for
    target: TargetState = field(default_factory=TargetState)
    memory: Memory = field(default_factory=blank)
    first_seq: int = 0  # the frame of row 0 of the last choice
    choice: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))  # (Tp,)
    probability: Array = field(default_factory=lambda: np.zeros(0, np.float32))  # (Tp,)

    def asked_for(self, spec: TargetSpec) -> "PolicyState":
        """Return the state for this target, reset if it is another one; keep all ROI features."""
        if spec == self.spec:
            return self
        return PolicyState(spec=spec, memory=self.memory)


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The rules that a graph may set."""

    patience: int = 64  # frames for which the position of an unseen target stays a candidate
    roi_channels: int = 576
    target_prior: float = 30.0  # prior odds of the target's own track; 1: none


def observe(
    before: PolicyState, tracks: Tracks, rules: Rules
) -> tuple[PolicyState, Objects, Array]:
    """Process a frame; return the new state, the candidates and the condition."""
    seq, observed = tracks.header.seq, tracks.boxes.shape[1]
    spec, memory = before.spec, before.memory
    target = follow(before.target, spec, tracks, chosen_for(before, seq))
    ids = np.append(tracks.ids, np.int32(target.bound_id))
    looks = recall(memory, ids, seq=seq, observed=observed, channels=rules.roi_channels)
    candidates = encode_objects(tracks, looks[:-1])
    if carrier_row(target, tracks) >= 0:  # a carried target has no path of its own
        candidates = without(candidates, candidates.ids == target.bound_id)
    spot = encode_place(target, spec, tracks, looks[-1], patience=rules.patience)
    if spot is not None:
        candidates = joined(candidates, spot)
        candidates = without(candidates, unlike(target, spec, tracks, candidates.ids))
    return replace(before, target=target), candidates, encode_condition(target, spec, tracks)


def with_prior(probability: Array, candidates: Objects, target: TargetState, prior: float) -> Array:
    """Multiply the network's probability (N, Tp) by the target's prior, and normalise each step.

    The target is tracked by motion; the network knows it by appearance and position. Players of one
    team look alike, so the previous target is kept unless the network is `prior` times surer of
    another one.
    """
    own = candidates.ids == target.bound_id
    if target.bound_id < 0 or not own.any():
        return probability
    raised = np.where(own[:, None], prior, np.float32(1)) * probability
    return np.asarray(raised / raised.sum(0, keepdims=True), np.float32)


def fault(tracks: Tracks) -> str:
    """Return a sentence when the tracks contain non-finite numbers, else an empty string."""
    if all(np.isfinite(a).all() for a in (tracks.features, tracks.boxes, tracks.predicted)):
        return ""
    return f"policy.tracks: expected finite numbers in frame {tracks.header.seq}, got others"


def chosen_for(state: PolicyState, seq: int) -> Choice:
    """Return the last plan's choice for frame `seq`; none past its end."""
    row = seq - state.first_seq
    if not 0 <= row < len(state.choice):
        return Choice()
    return Choice(object_id=int(state.choice[row]), probability=float(state.probability[row]))


def decide(
    before: PolicyState,
    tracks: Tracks,
    candidates: Objects,
    probability: Array,
    picked: NDArray[np.intp],
) -> tuple[GazePlan, PolicyState]:
    """Return the plan that looks at candidate `picked[t]` (Tp,) at step t, and the new state."""
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
        probability=probability[picked, steps],
    )


def pick(probability: Array, how: Selection, rng: np.random.Generator) -> NDArray[np.intp]:
    """Pick one candidate per step: (N, Tp) -> (Tp,)."""
    if how == "argmax":
        return np.asarray(probability.argmax(0))
    reached = probability.cumsum(0) >= rng.random(probability.shape[1]) * probability.sum(0)
    return np.asarray(reached.argmax(0))


def out_of_sight(state: PolicyState, tracks: Tracks, patience: int) -> bool:
    """Whether no track is of the class asked for, and none was for `patience` frames.

    The network, which learned from scenes whose ball is seldom unseen for long, knows no answer.
    """
    since = max(state.target.seen_seq, state.target.asked_seq)
    return tracks.header.seq - since > patience and not of_class(tracks, state.spec.label).any()


def without_candidates(state: PolicyState, tracks: Tracks, horizon: int) -> GazePlan:
    """Return the plan without candidates: the target's last position, or the field's middle."""
    if state.target.placed:
        return stay(state.target.box, horizon)
    return stay(field_centre(tracks.header.geometry), horizon)
