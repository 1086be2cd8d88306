"""A policy that looks for a faint target: it verifies one candidate after another, then follows.

A ball of three pixels in the context is one of fifty candidates, behind boots, lines and scraps.
Full resolution tells them apart, if it is asked: the ROI shows the likeliest candidates one window
after another, until a verdict confirms one (operators.verify); one of which the context is sure
needs no looks. It is followed as in pursuit, without carriers. A target that was followed for a
while and is lost may have been kicked: what flies away from where it was is followed (`flight`).
Without such it is waited for and looked for among people, not among faint candidates again.

That is for a target asked for by its class. One asked for by id or box needs no search: the network
binds it to a track and follows it, as in `LearnedPolicy`. A person is followed by the rules of
`PursuitPolicy`, once that track has been one for three frames.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from operators.policy.candidates import context_odds, faint_odds, probability
from operators.policy.decision import PolicyState, fault
from operators.policy.flight import Flight, next_flight
from operators.policy.former import SEVERAL_LOOKS
from operators.policy.gaze_plan import PLACE, GazePlan, follow, future, of_class, row_of, stay
from operators.policy.learned import LearnedPolicy, LearnedPolicySettings
from operators.policy.pursuit import (
    MARGIN,
    SURE,
    Pursuit,
    PursuitPolicySettings,
    PursuitState,
    SearchSettings,
    noted,
    pursue,
    unlocked,
)
from operators.policy.target import TargetState
from operators.policy.verdicts import LOOKS
from pipeline import Header, RoiFeatures, Tracks
from pipeline.boxes import centres

EDGE_PX = 30.0  # as edge_px of operators.verify: nearer to a window's edge nothing is judged
OWN_GAIN = 0.2  # of the latest frame in the odds of the present target
LATE = 6  # frames more than `LOOKS` for which a candidate is waited for
PLAIN = 3  # frames in which the context shows a candidate that needs no looks
PERSON = 3  # frames as a person after which a target asked for by id or box is one
GIVEN_UP = 16  # latest candidates that could not be judged, which are passed over


@dataclass(frozen=True, kw_only=True)
class VerifyingPolicySettings(SearchSettings, LearnedPolicySettings):
    """What a graph may set.

    Those of `LearnedPolicy` count for a target asked for by id or box, of a person for the first
    frames. A class of `carriers` is one of people.
    """

    FORMER: ClassVar[Mapping[str, str]] = {
        **LearnedPolicySettings.FORMER, **SearchSettings.FORMER, **SEVERAL_LOOKS
    }  # fmt: skip

    least_probability: float = 0.08  # of a verified candidate, by context and ROI


@dataclass(frozen=True, kw_only=True)
class SearchState:
    """How far the search for a faint target has come."""

    kept: int = 0  # frames in which the gaze followed the present target
    followed: bool = False  # whether one was followed for `patience` frames
    refuted: int = 0  # frames in succession in which the present target was an unlikely one
    odds: float = 0.0  # of the present target, their logarithm
    shown_id: int = -1  # the candidate that is being looked at
    shown_seq: int = -1  # since when
    given_up: tuple[int, ...] = ()  # the last ones that the ROI could not judge


@dataclass(frozen=True, kw_only=True, eq=False)
class VerifyingState(PursuitState):
    """State between frames; immutable."""

    search: SearchState = field(default_factory=SearchState)
    flight: Flight = field(default_factory=Flight)
    learned: PolicyState = field(default_factory=PolicyState)  # of a target asked for by id or box
    person_frames: int = 0  # in succession, in which that target's track was a person

    @property
    def is_person(self) -> bool:
        """Whether one is asked for who is followed by rules; so it stays for this target."""
        return self.person_frames >= PERSON


class VerifyingPolicy(Pursuit[VerifyingPolicySettings]):
    """Always proposes windows, of candidates and of places as well as of the target.

    Of a target asked for by id or box it proposes what `LearnedPolicy` does, of a person, after
    the first frames, what `PursuitPolicy` does.
    """

    begins = VerifyingState
    _state: VerifyingState

    @classmethod
    def advise(
        cls, settings: VerifyingPolicySettings, upstream: Mapping[str, Any]
    ) -> Iterable[str]:
        """As `LearnedPolicy` does."""
        return LearnedPolicy.advise(settings, upstream)

    def open(self) -> None:
        """Load the network; raises `WeightsError` when it does not fit the settings."""
        super().open()
        self._learned = LearnedPolicy(self.settings)
        self._learned.open()

    def on_settings(self, settings: VerifyingPolicySettings) -> None:
        """Change the target from the next plan on.

        Raises `SettingsError`, before anything changes, for a class that the tracks do not have.
        """
        super().on_settings(settings)
        self._learned.ask(settings)

    def on_stream(self, header: Header) -> None:
        """Forget everything: ids of another stream are different objects."""
        super().on_stream(header)
        self._learned.on_stream(header)

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on."""
        return self._learned.summary()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._learned.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._learned.runs_on()

    def state(self) -> VerifyingState:
        """Return the state."""
        return replace(self._state, learned=self._learned.state())

    def restore(self, state: Any) -> None:
        """Take over another instance's state, reset if its target was another one."""
        super().restore(replace(state, learned=PolicyState()))  # kept in one place
        self._learned.restore(state.learned)

    def on_features(self, features: RoiFeatures) -> None:
        """Judge what the ROI showed, and keep it for the network."""
        super().on_features(features)
        self._learned.on_features(features)

    def plan(self, tracks: Tracks) -> GazePlan:
        """Return where to look in the frames after this one, and keep the new state."""
        now, s = self._state, self.settings
        if not now.spec.one:
            plan, self._state = seek(tracks, now, s)
        elif now.is_person and not fault(tracks):
            plan, after = pursue(tracks, now, PursuitPolicySettings(horizon=s.horizon))
            self._state = as_person(after, now.target)
        else:  # the network's policy also tells what is wrong with tracks
            plan = self._learned.plan(tracks)
            self._state = bound(tracks, now, self._learned.state().target)
        return plan


def bound(tracks: Tracks, now: VerifyingState, target: TargetState) -> VerifyingState:
    """Return the state after a frame in which the network followed a target: is it a person?

    A track may have another class in its first frames than it has later.
    """
    if now.is_person:
        return now
    row = row_of(tracks, target.bound_id)
    if row < 0 or tracks.name_of(row) not in now.spec.carriers:
        return replace(now, person_frames=0)
    return replace(
        now,
        person_frames=now.person_frames + 1,
        locked=target.bound_id,
        target=tracks.name_of(row),
        seen_seq=target.seen_seq,
        box=target.box,
    )


def as_person(now: VerifyingState, before: str) -> VerifyingState:
    """Return the state with a class of people, `before` where the target is misread as another.

    Nobody carries a person, and one who is lost comes back as a person.
    """
    if now.target in now.spec.carriers:
        return now
    return replace(now, target=before, carrier_id=-1)


def seek(
    tracks: Tracks, before: VerifyingState, rules: VerifyingPolicySettings
) -> tuple[GazePlan, VerifyingState]:
    """Return the plan for the frames after these tracks, and the new state."""
    odds = target_odds(tracks, before)
    chances, now = shares(odds), locked_on(tracks, before, odds, rules)
    search, row, shown, horizon = now.search, row_of(tracks, now.locked), -1, rules.horizon
    if row >= 0:
        now = replace(noted(tracks, row, now, replace(now.spec, carriers=())), flight=Flight())
    elif not search.followed:  # it was none: nothing is known of the target
        now = replace(now, seen_seq=-1)
        search = looked_at(tracks, now, chances, rules)
        shown = row_of(tracks, search.shown_id)
    if shown >= 0:
        return stay(future(tracks, shown, horizon), horizon), replace(now, search=search)
    search = replace(search, shown_id=-1)
    if row < 0:
        now = flown(tracks, replace(now, search=search), rules)
        row = row_of(tracks, now.flight.track_id)
        return (follow(tracks, row, horizon), now) if row >= 0 else unlocked(tracks, now, rules)
    search = replace(search, kept=search.kept + 1)
    now = replace(now, search=replace(search, followed=well_known(search, rules)))
    return follow(tracks, row, horizon), now


def well_known(search: SearchState, rules: VerifyingPolicySettings) -> bool:
    """Whether a target was followed for so long that, once lost, it is waited for."""
    return search.followed or (not search.refuted and search.kept >= rules.patience)


def flown(tracks: Tracks, now: VerifyingState, rules: VerifyingPolicySettings) -> VerifyingState:
    """Follow the lost target's flight, if there is one; the target was last seen where that is.

    The consumer is bound to it at once: a look would refute what is blurred.
    """
    lost = tracks.header.seq - now.seen_seq
    if now.seen_seq < 0 or (now.flight.track_id == PLACE and lost > rules.patience):
        return now
    now = replace(now, flight=next_flight(tracks, now.flight, now.spec, now.box, lost))
    row = row_of(tracks, now.flight.track_id)
    return noted(tracks, row, now, replace(now.spec, carriers=())) if row >= 0 else now


def target_odds(tracks: Tracks, now: VerifyingState) -> NDArray[np.float32]:
    """Return the logarithm of the odds that each track is the target: (n,); -inf: another class.

    Those of the present target change slowly: it is refuted wherever it is blurred or half hidden.
    """
    verdicts, ids = now.verdicts, tracks.ids
    odds = faint_odds(tracks.scores, verdicts.of(ids), verdicts.settled(ids))
    own = row_of(tracks, now.locked)
    if own >= 0:
        odds[own] = now.search.odds + OWN_GAIN * (odds[own] - now.search.odds)
    return np.where(of_class(tracks, now.spec.label), odds, np.float32(-np.inf))


def shares(odds: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the probability of each candidate where at most one of them is the target: (n,).

    >>> shares(np.array([0, -np.inf], np.float32)).tolist()
    [0.5, 0.0]
    """
    likely = np.exp(odds)
    return np.asarray(likely / (1 + likely.sum()), np.float32)


def locked_on(
    tracks: Tracks,
    now: VerifyingState,
    odds: NDArray[np.float32],
    rules: VerifyingPolicySettings,
) -> VerifyingState:
    """Keep, gain or change the track that is the target: the likeliest one that may be believed.

    That is a verified one, or one of which the context is sure enough that it needs no looks. One
    that has become unlikely is kept for `patience` frames or until another is verified; one that
    was followed as long is lost at once, and waited for, unless only its class is another one.
    """
    fit = now.verdicts.settled(tracks.ids)
    fit |= (probability(context_odds(tracks.scores)) >= SURE) & (tracks.visible.sum(1) >= PLAIN)
    fit &= np.isfinite(odds) & (probability(odds) >= rules.least_probability)
    own, search = row_of(tracks, now.locked), now.search
    rivals = np.where(fit & tracks.visible[:, -1], odds, -np.inf)
    best = int(rivals.argmax()) if len(rivals) else -1
    held = own >= 0 and (fit[own] or not tracks.visible[own, -1])
    to_beat = odds[own] + MARGIN if held else -np.inf
    if best >= 0 and best != own and rivals[best] > to_beat:
        search = replace(search, kept=0, refuted=0, odds=float(odds[best]))
        return replace(now, locked=int(tracks.ids[best]), search=search)
    refuted = 0 if own < 0 or fit[own] else search.refuted + 1
    of_its_class = own >= 0 and bool(np.isfinite(odds[own]))  # a kit may be misread for a moment
    if own < 0 or refuted >= (1 if search.followed and of_its_class else rules.patience):
        return replace(now, locked=-1, search=replace(search, refuted=0))
    last = float(odds[own]) if np.isfinite(odds[own]) else search.odds  # -inf: of another class
    return replace(now, search=replace(search, refuted=refuted, odds=last))


def looked_at(
    tracks: Tracks,
    now: VerifyingState,
    chances: NDArray[np.float32],
    rules: VerifyingPolicySettings,
) -> SearchState:
    """Return the search with the candidate to look at: the one before, the next, or none.

    The next is that around which a window most probably shows the target, less the looks that were
    taken; `chances` (n,) are probabilities. A look that was begun goes on until it has
    its verdict, for `LATE` frames more at most, and while its window shows an open candidate.
    """
    seq, views, search = tracks.header.seq, now.verdicts.views(tracks.ids), now.search
    open_ones = (chances > 0) & (views < LOOKS)
    row, given_up = row_of(tracks, search.shown_id), search.given_up
    if row >= 0 and views[row] < LOOKS:
        late = seq - search.shown_seq > LOOKS + LATE
        if not late and window_sums(tracks, chances * open_ones)[row] > 0:
            return search
        if late:
            given_up = (*given_up, search.shown_id)[-GIVEN_UP:]
    value = window_sums(tracks, chances * open_ones * (1 - views / LOOKS))
    possible = open_ones & tracks.visible[:, -1] & (value > 0)
    possible &= ~np.isin(tracks.ids, (search.shown_id, *given_up))
    chosen = int(np.where(possible, value, -np.inf).argmax()) if possible.any() else -1
    shown_id = int(tracks.ids[chosen]) if chosen >= 0 else -1
    return replace(search, shown_id=shown_id, shown_seq=seq, given_up=given_up)


def window_sums(tracks: Tracks, worth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return what the window around each track shows of `worth` (n,) away from its edge: (n,)."""
    geometry = tracks.header.geometry
    half = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32) / 2
    whole = np.array([geometry.width_px, geometry.height_px], np.float32)
    places = centres(tracks.boxes[:, -1])
    middles = np.clip(places, half, np.maximum(whole - half, half))
    shown = (np.abs(middles[:, None] - places[None]) < half - EDGE_PX).all(2)
    return np.asarray((shown * worth[None]).sum(1))
