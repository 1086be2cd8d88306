"""A policy that looks at each object in turn: Tracks -> Scanpath. A baseline of the paper."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import (
    GazePlan,
    field_centre,
    future,
    of_class,
    scanpath,
    stay,
)
from operators.policy.of_class import ClassPolicy, ClassPolicySettings
from pipeline import Header, Scanpath, SettingsError, Tracks


@dataclass(frozen=True, kw_only=True)
class RoundRobinPolicySettings(ClassPolicySettings):
    """What a graph may set."""

    dwell: int = 4  # frames per object

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dwell < 1:
            raise SettingsError(f"dwell: must be at least 1, got {self.dwell}")


@dataclass(frozen=True, kw_only=True)
class RoundRobinState:
    """The current object, and the frame in which its turn began."""

    object_id: int = -1
    since_seq: int = -1


class RoundRobinPolicy(ClassPolicy[RoundRobinPolicySettings]):
    """Without objects, it looks at the middle of the field."""

    def open(self) -> None:
        """Start a round."""
        super().open()
        self._state = RoundRobinState()

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other objects."""
        self._state = RoundRobinState()

    def state(self) -> RoundRobinState:
        """Return the current turn."""
        return self._state

    def restore(self, state: RoundRobinState) -> None:
        """Take over the round of another instance."""
        self._state = state

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        s, self._names = self.settings, tracks.names
        plan, self._state = round_robin(
            tracks, self._state, target=s.target, dwell=s.dwell, horizon=s.horizon
        )
        return scanpath(tracks, plan)


def round_robin(
    tracks: Tracks, turn: RoundRobinState, *, target: str, dwell: int, horizon: int
) -> tuple[GazePlan, RoundRobinState]:
    """Return a plan that visits each object by id for `dwell` frames; `target` selects a class.

    The next higher id is next, so that appearing and disappearing objects do not disturb the round.
    Without objects the plan is the middle of the field.
    """
    rows = np.flatnonzero(of_class(tracks, target))
    if not len(rows):
        return stay(field_centre(tracks.header.geometry), horizon), RoundRobinState()
    ids = tracks.ids[rows]
    now = tracks.header.seq + 1
    if turn.object_id < 0:
        turn = RoundRobinState(object_id=int(ids[0]), since_seq=now)
    elif turn.object_id not in ids or now - turn.since_seq >= dwell:
        turn = RoundRobinState(object_id=int(ids[after(ids, turn.object_id)]), since_seq=now)
    first = int(np.flatnonzero(ids == turn.object_id)[0])
    frames = np.arange(horizon)
    places = (first + (now - turn.since_seq + frames) // dwell) % len(rows)
    boxes = np.stack([future(tracks, int(row), horizon) for row in rows])
    return GazePlan(choice=ids[places], boxes=boxes[places, frames]), turn


def after(ids: NDArray[np.int32], last: int) -> int:
    """Index of the next higher id than `last`, or 0 at the end of the round; ids ascending.

    >>> after(np.array([2, 5, 9], np.int32), 5), after(np.array([2, 5, 9], np.int32), 9)
    (2, 0)
    """
    return int(np.searchsorted(ids, last, side="right")) % len(ids)
