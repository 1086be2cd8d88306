"""A policy that follows one object by rules: Tracks -> Scanpath.

It finds the object, follows it, waits where it was lost, and searches for it.

A small ball is lost by false locks rather than by bad predictions, hence these rules:

- A candidate must have been seen in `confirm` frames, and a rival must be better by a margin for
  `confirm` frames in succession, before the gaze changes.
- A target asked for by class that is misread is kept until another of that class is seen.
- A target unseen for a few frames that was last near a person is carried by them: look there.
- A candidate of a class is the target where its odds allow it, by its score and by what the ROI
  showed of it (verdicts.py): a weak one only once it was verified, and no longer when refuted.
- With `in_play`, before a fixed camera, a candidate that moves or has a person near is likelier,
  and may be followed unverified; one that rests, alone or for long, is hardly one (in_play.py).
- Nobody near: look where it was seen last. After `patience` frames what was asked for by its class
  is looked for where most people are, who may have the ball; without people in the field, window
  by window, nearest to the last place first.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.policy.candidates import Sightings, count, nearest, none_seen, odds, probability
from operators.policy.carrier import can_carry
from operators.policy.former import CARRIERS, STRATEGY
from operators.policy.gaze_plan import (
    GazePlan,
    check_horizon,
    follow,
    future,
    of_class,
    row_of,
    scanpath,
    stay,
)
from operators.policy.in_play import Places, no_places, places_after, play_odds, tells
from operators.policy.inputs import PolicyInputs
from operators.policy.search import busiest, search
from operators.policy.target import (
    BIND_IOU,
    GROWTH,
    TargetSettings,
    TargetSpec,
    check_known,
    check_label,
    unknown_label,
)
from operators.policy.verdicts import Verdicts, judged, none_given
from pipeline import Header, RoiFeatures, Scanpath, SettingsError, Tracks
from pipeline.boxes import centres, iou, sizes

log = logging.getLogger(__name__)
MARGIN = 1.0  # of the odds, in nats, by which a rival must be better
SURE = 0.8  # probability from which a candidate is the target to the consumer
COAST = 3  # frames without detection before a person nearby counts as carrier
CARRIER_REACH = 3.0  # box sizes between a target and a possible carrier


@dataclass(frozen=True, kw_only=True)
class SearchSettings(TargetSettings):
    """What a graph may set of every policy that looks for one target and pursues it by rules."""

    FORMER: ClassVar[Mapping[str, str]] = {**STRATEGY, **CARRIERS}

    horizon: int = 16  # Tp, frames planned
    patience: int = 24  # frames to wait at the last place before searching for a class
    # of a candidate of class `target`, by score and looks, as the shipped detector and encoder give
    # them; 0: any
    least_probability: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_horizon(self.horizon)
        if self.patience < 0:
            raise SettingsError(f"patience: must be at least 0, got {self.patience}")
        if not 0 <= self.least_probability < 1:
            raise SettingsError(
                f"least_probability: must be at least 0 and below 1, got {self.least_probability}"
            )


@dataclass(frozen=True, kw_only=True)
class PursuitPolicySettings(SearchSettings):
    """What a graph may set. The target is `target_id`, else `prompt_box`, else class `target`."""

    confirm: int = 3  # sightings before the gaze moves to a candidate
    # before a fixed camera: what rests, with nobody near or for long, is hardly the target
    in_play: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.confirm < 1:
            raise SettingsError(f"confirm: must be at least 1, got {self.confirm}")


@dataclass(frozen=True, kw_only=True, eq=False)
class PursuitState:
    """State between frames; immutable."""

    spec: TargetSpec = field(default_factory=TargetSpec)  # the target that was asked for
    locked: int = -1  # track id
    target: str = ""  # class of what was locked
    seen_seq: int = -1  # when the target was last seen; -1: never
    box: NDArray[np.float32] = field(default_factory=lambda: np.zeros(4, np.float32))  # the last
    carrier_id: int = -1  # the person nearest to it when it was last seen
    rival: int = -1
    rival_frames: int = 0
    sightings: Sightings = field(default_factory=none_seen)
    verdicts: Verdicts = field(default_factory=none_given)
    places: Places = field(default_factory=no_places)  # where candidates are at rest

    @property
    def wanted(self) -> str:
        """The class asked for; of one object, and without a class, that of what was locked."""
        if self.spec.one or not self.spec.label:
            return self.target or self.spec.label
        return self.spec.label

    def asked_for(self, spec: TargetSpec) -> "PursuitState":
        """Return the state for this target, reset if the target is another one; keep verdicts."""
        return self if spec == self.spec else type(self)(spec=spec, verdicts=self.verdicts)


S = TypeVar("S", bound=SearchSettings)
State = TypeVar("State", bound=PursuitState)


class Pursuit(PolicyInputs[S]):
    """What policies share that pursue one target: its state, and what changes it."""

    live: ClassVar[tuple[str, ...]] = (
        "target", "target_id", "prompt_box", "least_probability",
    )  # fmt: skip
    begins: ClassVar[type[PursuitState]] = PursuitState  # with a state of this class

    @classmethod
    def advise(cls, settings: S, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `SettingsError` for a class that the detector does not know."""
        check_known(settings.target, upstream)
        return ()

    def open(self) -> None:
        """Start without state."""
        self._state = self.begins(spec=self.settings.spec)
        self._names: Sequence[str] = ()  # of the classes that tracks have

    def on_settings(self, settings: S) -> None:
        """Change the target from the next plan on.

        Raises `SettingsError` for a class that the tracks do not have.
        """
        if settings.target != self.settings.target:
            check_label(settings.target, self._names)
        self.settings = settings
        self._state = self._state.asked_for(settings.spec)

    def on_stream(self, header: Header) -> None:
        """Forget everything: ids of another stream are different objects."""
        self._state = self.begins(spec=self._state.spec)

    def state(self) -> PursuitState:
        """Return the state."""
        return self._state

    def restore(self, state: PursuitState) -> None:
        """Take over another instance's state, reset if its target was another one."""
        self._state = state.asked_for(self._state.spec)

    def on_features(self, features: RoiFeatures) -> None:
        """Judge what the ROI showed."""
        if np.isfinite(features.genuine).all():
            verdicts = judged(self._state.verdicts, features)
            self._state = replace(self._state, verdicts=verdicts)

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one; a class that the tracks do not have is logged once."""
        if tracks.names != self._names:
            self._names = tracks.names
            if sentence := unknown_label(self.settings.target, tracks.names):
                log.warning(sentence)
        return scanpath(tracks, self.plan(tracks))

    def plan(self, tracks: Tracks) -> GazePlan:
        """Return where to look in the frames after this one, and keep the new state."""
        raise NotImplementedError


class PursuitPolicy(Pursuit[PursuitPolicySettings]):
    """Always proposes windows: without objects, positions to look at."""

    def plan(self, tracks: Tracks) -> GazePlan:
        """Return where to look in the frames after this one, and keep the new state."""
        plan, self._state = pursue(tracks, self._state, self.settings)
        return plan


def pursue(tracks: Tracks, before: State, rules: PursuitPolicySettings) -> tuple[GazePlan, State]:
    """Return the plan for the frames after these tracks, and the new state.

    Of `rules` its numbers count; the target is the state's.
    """
    now = replace(before, sightings=count(before.sightings, tracks))
    if rules.in_play and tells(now.spec):
        now = replace(now, places=places_after(now.places, tracks, now.spec))
    log_odds = rated(tracks, now, rules)
    now = locked_on(tracks, now, rules, log_odds)
    row = row_of(tracks, now.locked)
    if row < 0:
        return unlocked(tracks, now, rules)
    now = noted(tracks, row, now, now.spec)
    carrier = carrier_of(tracks, now)
    if carrier >= 0:
        return stay(future(tracks, carrier, rules.horizon), rules.horizon), now
    if not told(log_odds[row : row + 1], rules):
        return stay(future(tracks, row, rules.horizon), rules.horizon), now
    return follow(tracks, row, rules.horizon), now


def carrier_of(tracks: Tracks, now: PursuitState) -> int:
    """Row of the person who carries a target that was unseen for some frames, -1: nobody."""
    late = tracks.header.seq - now.seen_seq > COAST
    return row_of(tracks, now.carrier_id) if late else -1


def told(log_odds: NDArray[np.float32], rules: PursuitPolicySettings) -> bool:
    """Whether the consumer is told that a track is the target, and not only shown its place.

    A faint candidate is looked at to be verified; a consumer that is bound to it loses its own.
    """
    return bool(probability(log_odds)[0] >= SURE or not rules.least_probability)


def locked_on(
    tracks: Tracks, now: State, rules: PursuitPolicySettings, log_odds: NDArray[np.float32]
) -> State:
    """Keep, gain or change the track that is the target, by the odds of each (n,)."""
    spec = now.spec
    if row_of(tracks, now.locked) >= 0:
        if spec.one:
            return now
        if likely(log_odds, rules)[row_of(tracks, now.locked)]:
            return challenged(tracks, now, rules, log_odds)
    row = first_lock(tracks, spec) if now.seen_seq < 0 else -1
    if row < 0 and (now.seen_seq >= 0 or not spec.one):
        row = regained(tracks, now, rules, log_odds)
    locked = int(tracks.ids[row]) if row >= 0 else -1
    return replace(now, locked=locked, rival=-1, rival_frames=0)


def eligible(
    tracks: Tracks, now: PursuitState, rules: PursuitPolicySettings, log_odds: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return which tracks may be the target: (n,)."""
    fit = of_class(tracks, now.wanted) & tracks.visible[:, -1]
    fit &= now.sightings.counts >= rules.confirm
    return fit & likely(log_odds, rules)


def likely(log_odds: NDArray[np.float32], rules: PursuitPolicySettings) -> NDArray[np.bool_]:
    """Return which tracks are probable enough to be what they are reported as: (n,)."""
    return np.asarray(probability(log_odds) >= rules.least_probability)


def rated(tracks: Tracks, now: PursuitState, rules: PursuitPolicySettings) -> NDArray[np.float32]:
    """Return the logarithm of the odds of each track: (n,)."""
    found = odds(tracks, now.verdicts.of(tracks.ids))
    if rules.in_play and tells(now.spec):
        found += play_odds(tracks, now.spec, now.places)
    return found


def first_lock(tracks: Tracks, spec: TargetSpec) -> int:
    """Row of the object asked for by id or by box, -1 when it is not there."""
    if spec.object_id >= 0:
        return row_of(tracks, spec.object_id)
    if spec.boxed and len(tracks.ids):
        overlap = iou(tracks.boxes[:, -1], np.array([spec.box], np.float32))[:, 0]
        return int(overlap.argmax()) if overlap.max() >= BIND_IOU else -1
    return -1


def regained(
    tracks: Tracks, now: PursuitState, rules: PursuitPolicySettings, log_odds: NDArray[np.float32]
) -> int:
    """Row of the best confirmed candidate, -1: none.

    One of many alike (asked for by id or by box) must be near where it was lost; the distance it
    may have gone grows with time. A class may turn up anywhere.
    """
    fit = eligible(tracks, now, rules, log_odds)
    if now.spec.one:
        gone = tracks.header.seq - now.seen_seq
        away = np.linalg.norm(centres(tracks.boxes[:, -1]) - centres(now.box), axis=1)
        fit &= away <= (1 + GROWTH * gone) * sizes(now.box[None])
        value = -away.astype(np.float32)
    else:
        value = log_odds
    return int(np.where(fit, value, -np.inf).argmax()) if fit.any() else -1


def challenged(
    tracks: Tracks, now: State, rules: PursuitPolicySettings, log_odds: NDArray[np.float32]
) -> State:
    """Change to a rival that has been clearly better for `confirm` frames in succession.

    To a target that is no longer taken for one of its class any rival of that class is better.
    """
    fit = eligible(tracks, now, rules, log_odds)
    own = row_of(tracks, now.locked)
    best = int(np.where(fit, log_odds, -np.inf).argmax())
    of_its_class = of_class(tracks, now.spec.label)[own]  # without a class asked for: always
    to_beat = log_odds[own] + MARGIN if of_its_class else -np.inf
    if not fit[best] or log_odds[best] <= to_beat:
        return replace(now, rival=-1, rival_frames=0)
    rival = int(tracks.ids[best])
    frames = now.rival_frames + 1 if rival == now.rival else 1
    if frames < rules.confirm:
        return replace(now, rival=rival, rival_frames=frames)
    return replace(now, locked=rival, rival=-1, rival_frames=0)


def noted(tracks: Tracks, row: int, now: State, spec: TargetSpec) -> State:
    """Remember where the target is, what it is and who is beside it."""
    box = tracks.boxes[row, -1]
    if not tracks.visible[row, -1]:
        # prompted while undetected: its absence counts from now
        return replace(
            now, box=box, seen_seq=now.seen_seq if now.seen_seq >= 0 else tracks.header.seq
        )
    now = replace(now, target=tracks.name_of(row))
    could = can_carry(tracks, spec.carriers, now.wanted)
    could[row] = False  # misread as a person
    rows = np.flatnonzero(could)
    at, _ = nearest(box, tracks.boxes[rows, -1], CARRIER_REACH * float(sizes(box[None])[0]))
    return replace(
        now,
        box=box,
        seen_seq=tracks.header.seq,
        carrier_id=int(tracks.ids[rows[at]]) if at >= 0 else -1,
    )


def unlocked(tracks: Tracks, now: State, rules: SearchSettings) -> tuple[GazePlan, State]:
    """Return where to look without a target: its carrier, its last position, then everywhere."""
    spec, horizon = now.spec, rules.horizon
    carrier = row_of(tracks, now.carrier_id)
    if carrier >= 0:
        return stay(future(tracks, carrier, horizon), horizon), now
    header = tracks.header
    if now.seen_seq < 0 and spec.boxed:
        return stay(np.array(spec.box, np.float32), horizon), now
    if now.seen_seq >= 0 and spec.one:  # one of many alike comes back to where it was lost
        return stay(now.box, horizon), now
    ahead = header.seq + 1 + np.arange(horizon)
    if now.seen_seq < 0 or header.seq - now.seen_seq > rules.patience:
        crowd = busiest(tracks, spec, now.wanted)
        if crowd is not None:
            return stay(crowd, horizon), now
    if now.seen_seq < 0:
        return stay(search(header.geometry, None, ahead), horizon), now
    frames = ahead - now.seen_seq
    places = search(header.geometry, centres(now.box), np.maximum(frames - rules.patience - 1, 0))
    return stay(np.where((frames <= rules.patience)[:, None], now.box, places), horizon), now
