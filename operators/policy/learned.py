"""A trained policy: Tracks (and their ROI features) -> Scanpath.

For every frame k it returns a plan for k+1 … k+Tp: a network chooses among the tracks and the
position of the target.
"""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from operators.policy.conditioning import unmet
from operators.policy.decision import (
    PolicyState,
    Rules,
    Selection,
    decide,
    fault,
    observe,
    out_of_sight,
    pick,
    with_prior,
    without_candidates,
)
from operators.policy.former import CARRIERS, FEEDBACK, PRIOR, STRATEGY, VERIFIED
from operators.policy.gaze_plan import GazePlan, check_horizon, no_proposal, scanpath, stay
from operators.policy.inputs import PolicyInputs
from operators.policy.memory import fault as fault_of_looks
from operators.policy.memory import remember
from operators.policy.network import PolicyNetwork, file_of
from operators.policy.search import busiest
from operators.policy.target import TargetSettings, check_known, check_label, told_before
from pipeline import (
    Header,
    RoiFeatures,
    Scanpath,
    SettingsError,
    Tracks,
)
from pipeline.providers import NetworkSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class LearnedPolicySettings(TargetSettings, NetworkSettings):
    """What a graph may set. The target is `target_id`, else `prompt_box`, else class `target`."""

    FORMER: ClassVar[Mapping[str, str]] = {**STRATEGY, **CARRIERS, **PRIOR, **FEEDBACK, **VERIFIED}

    # an ONNX file of operators.policy.train; empty: the shipped one; long_horizon: the shipped one
    # of To 10 and Tp 200
    weights: str = ""
    selection: Selection = "argmax"  # the likeliest object, or one drawn by its probability
    seed: int = 0  # of what is drawn
    target_prior: float = Rules.target_prior  # see `decision.with_prior`; 1: the network alone
    horizon: int = 16  # Tp, frames planned
    observed: int = 4  # To, frames of looks that are remembered
    # frames for which the last position stays a candidate; then people are searched for a ball
    place_patience: int = Rules.patience

    def __post_init__(self) -> None:
        TargetSettings.__post_init__(self)
        NetworkSettings.__post_init__(self)
        check_horizon(self.horizon)
        if self.observed < 1:
            raise SettingsError(f"observed: must be at least 1, got {self.observed}")
        for name in ("place_patience", "seed"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if not 1 <= self.target_prior < math.inf:
            raise SettingsError(
                f"target_prior: must be at least 1 and finite, got {self.target_prior}"
            )


class LearnedPolicy(PolicyInputs[LearnedPolicySettings]):
    """Always proposes windows: without objects, positions to look at.

    Only for non-finite inputs it makes no proposal, so that the last plan stays in effect.
    """

    live: ClassVar[tuple[str, ...]] = ("target", "target_id", "prompt_box")

    @classmethod
    def advise(cls, settings: LearnedPolicySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `SettingsError` for tracks that this policy does not go with.

        They must know the target's class, describe objects as the network was trained on, and have
        its history and horizon; raises `WeightsError` where the settings have another one.
        """
        check_known(settings.target, upstream)
        channels = told_before("feature_channels", upstream)
        network = PolicyNetwork(file_of(settings.weights))
        if channels not in (None, network.context_channels):
            raise SettingsError(
                f"weights: {network.path.name} reads {network.context_channels} features of each "
                f"object, expected a detector with as many, got one with {channels}; "
                "operators.policy:PursuitPolicy needs none"
            )
        network.suits(horizon=settings.horizon, observed=settings.observed)
        for name in ("observed", "horizon"):
            needed, got = getattr(settings, name), told_before(name, upstream)
            if got not in (None, needed):
                raise SettingsError(
                    f"weights: {network.path.name} expects tracks of {name} {needed}, got {got}"
                )
        return ()

    def open(self) -> None:
        """Load the network; raises `WeightsError` when it does not fit the settings."""
        s = self.settings
        self._network = PolicyNetwork(file_of(s.weights), **s.compute)
        self._network.suits(horizon=s.horizon, observed=s.observed)
        self._state = PolicyState(spec=s.spec)
        self._warned: set[str] = set()
        self._names: Sequence[str] = ()  # of the classes that tracks have

    def on_settings(self, settings: LearnedPolicySettings) -> None:
        """Change the target from the next plan on; ROI features of all objects are kept.

        Raises `SettingsError` for a class that the tracks do not have.
        """
        if settings.target != self.settings.target:
            check_label(settings.target, self._names)
        self.ask(settings)

    def ask(self, settings: LearnedPolicySettings) -> None:
        """Change the target, whose class the caller has checked, from the next plan on."""
        self.settings, before = settings, self._state
        self._state = before.asked_for(settings.spec)
        if self._state is not before:
            self._warned.discard("prompt")

    def on_stream(self, header: Header) -> None:
        """Forget everything: ids of another stream are different objects."""
        self._state = PolicyState(spec=self._state.spec)

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on."""
        return self._network.network.where()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._network.network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._network.network.provider

    def state(self) -> PolicyState:
        """Return the state."""
        return self._state

    def restore(self, state: PolicyState) -> None:
        """Take over another instance's state, reset if its target was another one."""
        self._state = state.asked_for(self._state.spec)

    def on_features(self, features: RoiFeatures) -> None:
        """Store the ROI features of the last frames."""
        wrong = fault_of_looks(features)
        self._warn_once("looks", wrong)
        if not wrong:
            memory = remember(self._state.memory, features, self.settings.observed)
            self._state = replace(self._state, memory=memory)

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        return scanpath(tracks, self.plan(tracks))

    def plan(self, tracks: Tracks) -> GazePlan:
        """Return the network's plan, and keep the new state."""
        self._names = tracks.names
        s, network = self.settings, self._network
        network.check(tracks)
        wrong = fault(tracks)
        self._warn_once("tracks", wrong)
        if wrong:
            return no_proposal()
        rules = Rules(
            patience=s.place_patience,
            roi_channels=network.roi_channels,
            target_prior=s.target_prior,
        )
        state, candidates, condition = observe(self._state, tracks, rules)
        self._warn_once("prompt", unmet(state.target, state.spec, tracks))
        crowd = None
        if out_of_sight(state, tracks, rules.patience):
            crowd = busiest(tracks, state.spec, state.spec.label)
        if crowd is not None:
            plan = stay(crowd, network.horizon)
        elif len(candidates.ids):
            believed = network(candidates, condition)
            probability = with_prior(believed, candidates, state.target, rules.target_prior)
            rng = np.random.default_rng([s.seed, tracks.header.seq])
            picked = pick(probability, s.selection, rng)
            plan, state = decide(state, tracks, candidates, probability, picked)
        else:
            plan = without_candidates(state, tracks, network.horizon)
        self._state = state
        return plan

    def _warn_once(self, about: str, sentence: str) -> None:
        """Log a sentence once, until it changes or is empty."""
        if sentence and about not in self._warned:
            log.warning(sentence)
        (self._warned.add if sentence else self._warned.discard)(about)
