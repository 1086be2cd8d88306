"""A trained policy that reads: Tracks, ROI features and what was read -> Scanpath.

For every frame k it returns a plan for k+1 … k+Tp: a network chooses among the tracks and a search
of the field, so that as many texts as possible are read that were not read before. Several tracks
fit one window: which window shows the choice is left to dispatch.
"""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from operators.policy.decision import Selection, fault, pick
from operators.policy.gaze_plan import no_proposal, scanpath
from operators.policy.memory import fault as fault_of_looks
from operators.policy.memory import remember
from operators.policy.reading.decision import observe, plan_of
from operators.policy.reading.inputs import TextPolicy, TextPolicySettings, planned
from operators.policy.reading.network import SHIPPED, ReadingNetwork
from operators.policy.target import told_before
from pipeline import RoiFeatures, Scanpath, SettingsError, Tracks
from pipeline.providers import NetworkSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ReadingPolicySettings(TextPolicySettings, NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file of operators.policy.reading.train; empty: the shipped one
    selection: Selection = "argmax"  # the likeliest text, or one drawn by its probability
    seed: int = 0  # of what is drawn
    observed: int = 4  # To, frames of looks that are remembered

    def __post_init__(self) -> None:
        TextPolicySettings.__post_init__(self)
        NetworkSettings.__post_init__(self)
        if self.observed < 1:
            raise SettingsError(f"observed: must be at least 1, got {self.observed}")
        if self.seed < 0:
            raise SettingsError(f"seed: must be at least 0, got {self.seed}")


class ReadingPolicy(TextPolicy[ReadingPolicySettings]):
    """Always proposes windows; without tracks it searches.

    Only for non-finite inputs it makes no proposal, so that the last plan stays in effect.
    """

    @classmethod
    def advise(cls, settings: ReadingPolicySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `SettingsError` for a detector that this policy does not go with."""
        channels = told_before("feature_channels", upstream)
        network = ReadingNetwork(file_of(settings.weights))
        if channels not in (None, network.context_channels):
            raise SettingsError(
                f"weights: {network.path.name} reads {network.context_channels} features of each "
                f"text, expected a detector with as many, got one with {channels}; "
                "operators.policy:GreedyReadingPolicy needs none"
            )
        return ()

    def open(self) -> None:
        """Load the network; raises `WeightsError` when it does not fit the settings."""
        super().open()
        s = self.settings
        self._network = ReadingNetwork(file_of(s.weights), **s.compute)
        self._network.suits(horizon=s.horizon, observed=s.observed)
        self._sure = self._network.sure(s.sure)
        self._warned: set[str] = set()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._network.network.provider

    def on_settings(self, settings: ReadingPolicySettings) -> None:
        """Take another score as sure from the next plan on."""
        self.settings, self._sure = settings, self._network.sure(settings.sure)

    def on_features(self, features: RoiFeatures) -> None:
        """Store the ROI features of the last frames."""
        wrong = fault_of_looks(features)
        self._warn_once("features", wrong)
        if not wrong:
            memory = remember(self._state.memory, features, self.settings.observed)
            self._state = replace(self._state, memory=memory)

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        s, network = self.settings, self._network
        network.check(tracks)
        wrong = fault(tracks)
        self._warn_once("tracks", wrong)
        if wrong:
            return scanpath(tracks, no_proposal())
        if not len(tracks.ids):
            tracks = shaped(tracks, network)
        state, candidates, condition = observe(
            self._state, tracks, sure=self._sure, delay=s.delay, roi_channels=network.roi_channels
        )
        probability = network(candidates, condition)
        rng = np.random.default_rng([s.seed, tracks.header.seq])
        plan = plan_of(tracks, candidates, probability, pick(probability, s.selection, rng))
        self._state = planned(state, tracks, plan.boxes, s.delay)
        return scanpath(tracks, plan)

    def _warn_once(self, about: str, sentence: str) -> None:
        """Log a sentence once, until it is empty."""
        if sentence and about not in self._warned:
            log.warning(sentence)
        (self._warned.add if sentence else self._warned.discard)(about)


def shaped(tracks: Tracks, network: ReadingNetwork) -> Tracks:
    """Return no tracks in the shapes that the network expects."""
    return replace(
        tracks,
        boxes=np.zeros((0, network.observed, 4), np.float32),
        visible=np.zeros((0, network.observed), np.bool_),
        features=np.zeros((0, network.observed, network.context_channels), np.float32),
        predicted=np.zeros((0, network.horizon, 4), np.float32),
    )


def file_of(weights: str) -> Path:
    """Return the file that a setting `weights` means."""
    return Path(weights) if weights else SHIPPED
