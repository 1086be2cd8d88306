"""Decide where to look next: Tracks (and what the ROI showed of them) -> Scanpath.

Answers every frame k with a plan for k+1 … k+Tp. Strategies are functions of the tracks and a
state that is replaced, never changed: the same tracks in, the same plans out.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from operators.policy.baselines import Turn, centred, round_robin
from operators.policy.carrier import PEOPLE
from operators.policy.conditioning import unknown, unmet
from operators.policy.gaze_plan import GazePlan, no_proposal, scanpath
from operators.policy.learned import (
    SHIPPED,
    Gaze,
    PolicyNetwork,
    Rules,
    Selection,
    decide,
    fault,
    loyal,
    nothing,
    observe,
    pick,
)
from operators.policy.memory import Memory, blank, remember
from operators.policy.memory import fault as fault_of_looks
from operators.policy.pursuit import Pursuit, pursue
from operators.policy.target import TargetSpec
from pipeline import Header, Input, Operator, RoiFeatures, Scanpath, SettingsError, Tracks

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PolicySettings:
    """What a graph may set. The target is `target_id`, else `prompt_box`, else class `target`."""

    FORMER: ClassVar[Mapping[str, str]] = {"held_by": "expected carriers, its new name"}

    strategy: Literal["learned", "pursue", "round_robin", "centred"] = "pursue"
    weights: str = ""  # learned: an ONNX file of operators.policy.train; empty: the shipped one
    selection: Selection = "argmax"  # learned: the likeliest object, or one drawn by its chance
    seed: int = 0  # learned: of what is drawn
    loyalty: float = 30.0  # learned: see `operators.policy.learned.loyal`; 1: the network alone
    least_genuine: float = 0.2  # learned: below it an object that was looked at is believed false
    target: str = ""  # class name (ball, referee, player …); empty: any
    target_id: int = -1  # track id
    prompt_box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor pixels
    horizon: int = 16  # Tp, frames planned
    dwell: int = 4  # round robin: frames per object
    confirm: int = 3  # pursue: sightings before the gaze moves to a candidate
    patience: int = 24  # pursue: frames to wait at the last place before searching
    place_patience: int = 64  # learned: frames for which the last place stays worth a look
    observed: int = 4  # To, frames of looks that are remembered
    threads: int = 1
    carriers: tuple[str, ...] = PEOPLE  # classes that may carry a target that is out of sight

    def __post_init__(self) -> None:
        for name in ("horizon", "dwell", "confirm", "observed", "threads"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        for name in ("patience", "place_patience", "seed"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.least_genuine <= 1:
            raise SettingsError(f"least_genuine: must be within 0..1, got {self.least_genuine}")
        if not 1 <= self.loyalty < math.inf:
            raise SettingsError(f"loyalty: must be at least 1 and finite, got {self.loyalty}")
        left, top, right, bottom = self.prompt_box
        if any(self.prompt_box) and not (left < right and top < bottom):
            raise SettingsError(
                f"prompt_box: expected left, top, right, bottom, got {self.prompt_box}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyState:
    """What a policy remembers from frame to frame; of whom, says the spec."""

    spec: TargetSpec = field(default_factory=TargetSpec)
    pursuit: Pursuit = field(default_factory=Pursuit)
    turn: Turn = field(default_factory=Turn)
    gaze: Gaze = field(default_factory=Gaze)
    memory: Memory = field(default_factory=blank)


class Policy(Operator[PolicySettings, Scanpath]):
    """Never silent: a frame without objects is answered with places to look at.

    Only what is no number is answered with no proposal, so that the last plan stays in force.
    """

    tracks = Input(Tracks, keep="every")
    features = Input(RoiFeatures, join=False)
    live: ClassVar[tuple[str, ...]] = ("target", "target_id", "prompt_box", "least_genuine")

    def open(self) -> None:
        """Start without a past; raises `WeightsError` when no network fits the settings."""
        s = self.settings
        self._state = PolicyState()
        self._network: PolicyNetwork | None = None
        if s.strategy == "learned":
            self._network = PolicyNetwork(
                Path(s.weights) if s.weights else SHIPPED, threads=s.threads
            )
            self._network.suits(horizon=s.horizon, observed=s.observed)
        self._ailing: set[str] = set()
        self._names: Sequence[str] = ()  # of the classes that tracks have
        self._look_for(s)

    def on_settings(self, settings: PolicySettings) -> None:
        """Another target from the next plan on; what everybody looks like stays known.

        Raises `SettingsError` for a class that the tracks do not have.
        """
        another = settings.target != self.settings.target
        if another and (sentence := unknown(settings.target, self._names)):
            raise SettingsError(sentence)
        self.settings, before = settings, self._spec
        self._look_for(settings)
        if self._spec != before:
            self._state = replace(self._state, pursuit=Pursuit(), gaze=Gaze())
            self._ailing.discard("prompt")

    def _look_for(self, s: PolicySettings) -> None:
        self._spec = TargetSpec(
            object_id=s.target_id, box=s.prompt_box, label=s.target, carriers=s.carriers
        )

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other objects."""
        self._state = PolicyState()

    def state(self) -> PolicyState:
        """Everything remembered."""
        return replace(self._state, spec=self._spec)

    def restore(self, state: PolicyState) -> None:
        """Go on where another instance stopped; after another target, if it had another."""
        if state.spec != self._spec:
            state = replace(state, pursuit=Pursuit(), gaze=Gaze())
        self._state = state

    def on_features(self, features: RoiFeatures) -> None:
        """Keep the looks of the last frames."""
        wrong = fault_of_looks(features)
        self._complain("looks", wrong)
        if wrong:
            return
        memory = remember(self._state.memory, features, self.settings.observed)
        self._state = replace(self._state, memory=memory)

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        self._names = tracks.names
        return scanpath(tracks, self._plan(tracks))

    def _plan(self, tracks: Tracks) -> GazePlan:
        s, state = self.settings, self._state
        if s.strategy == "learned" and self._network is not None:
            return self._chosen(tracks, self._network)
        if s.strategy == "centred":
            return centred(tracks, s.horizon)
        if s.strategy == "round_robin":
            plan, turn = round_robin(
                tracks, state.turn, target=s.target, dwell=s.dwell, horizon=s.horizon
            )
            self._state = replace(state, turn=turn)
            return plan
        plan, pursuit = pursue(
            tracks,
            state.pursuit,
            self._spec,
            confirm=s.confirm,
            patience=s.patience,
            horizon=s.horizon,
        )
        self._state = replace(state, pursuit=pursuit)
        return plan

    def _chosen(self, tracks: Tracks, network: PolicyNetwork) -> GazePlan:
        """What the network chooses."""
        s, state = self.settings, self._state
        network.check(tracks)
        wrong = fault(tracks)
        self._complain("tracks", wrong)
        if wrong:
            return no_proposal()
        rules = Rules(
            patience=s.place_patience,
            least_genuine=s.least_genuine,
            roi_channels=network.roi_channels,
            loyalty=s.loyalty,
        )
        gaze, candidates, condition = observe(state.gaze, self._spec, tracks, state.memory, rules)
        self._complain("prompt", unmet(gaze.target, self._spec, tracks))
        if len(candidates.ids):
            believed = network(candidates, condition)
            probability = loyal(believed, candidates, gaze.target, rules.loyalty)
            rng = np.random.default_rng([s.seed, tracks.header.seq])
            picked = pick(probability, s.selection, rng)
            plan, gaze = decide(gaze, tracks, candidates, probability, picked)
        else:
            plan = nothing(gaze, tracks, network.horizon)
        self._state = replace(state, gaze=gaze)
        return plan

    def _complain(self, about: str, sentence: str) -> None:
        """Log a sentence once, until there is nothing to complain of any more."""
        if sentence and about not in self._ailing:
            log.warning(sentence)
        (self._ailing.add if sentence else self._ailing.discard)(about)
