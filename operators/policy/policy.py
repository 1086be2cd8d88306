"""Decide where to look next: Tracks (and what the ROI showed of them) -> Scanpath.

Answers every frame k with a plan for k+1 … k+Tp. Strategies are functions of the tracks and a
state that is replaced, never changed: the same tracks in, the same plans out.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

from operators.policy.baselines import Turn, centred, round_robin
from operators.policy.memory import Memory, blank, remember
from operators.policy.plan import Plan, scanpath
from operators.policy.pursuit import Aim, Pursuit, pursue
from pipeline import Header, Input, Operator, RoiFeatures, Scanpath, SettingsError, Tracks

MEMORY_PER_OBJECT = 4  # objects that come and go, for each of the 25 that are reported at once
MOST_OBJECTS = 25


@dataclass(frozen=True, kw_only=True)
class PolicySettings:
    """What a graph may set. The target is `target_id`, else `prompt_box`, else class `target`."""

    strategy: Literal["pursue", "round_robin", "centred"] = "pursue"
    target: str = ""  # class name (ball, referee, player …); empty: any
    target_id: int = -1  # track id
    prompt_box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor pixels
    horizon: int = 16  # Tp, frames planned
    dwell: int = 4  # round robin: frames per object
    confirm: int = 3  # pursue: sightings before the gaze moves to a candidate
    patience: int = 24  # pursue: frames to wait at the last place before searching
    held_by: tuple[str, ...] = ("player", "goalkeeper", "referee", "person")

    def __post_init__(self) -> None:
        for name in ("horizon", "dwell", "confirm"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        if self.patience < 0:
            raise SettingsError(f"patience: must be at least 0, got {self.patience}")
        left, top, right, bottom = self.prompt_box
        if any(self.prompt_box) and not (left < right and top < bottom):
            raise SettingsError(
                f"prompt_box: expected left, top, right, bottom, got {self.prompt_box}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyState:
    """What a policy remembers from frame to frame."""

    pursuit: Pursuit = field(default_factory=Pursuit)
    turn: Turn = field(default_factory=Turn)
    memory: Memory = field(default_factory=lambda: blank(MEMORY_PER_OBJECT * MOST_OBJECTS))


class Policy(Operator[PolicySettings, Scanpath]):
    """Never silent: a frame without objects is answered with places to look at."""

    tracks = Input(Tracks, keep="every")
    features = Input(RoiFeatures, join=False)

    def open(self) -> None:
        """Start without a past."""
        s = self.settings
        self._state = PolicyState()
        self._aim = Aim(object_id=s.target_id, box=s.prompt_box, target=s.target, held_by=s.held_by)

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other objects."""
        self._state = PolicyState()

    def state(self) -> PolicyState:
        """Everything remembered."""
        return self._state

    def restore(self, state: PolicyState) -> None:
        """Go on where another instance stopped."""
        self._state = state

    def on_features(self, features: RoiFeatures) -> None:
        """Keep the newest look at each object."""
        self._state = replace(self._state, memory=remember(self._state.memory, features))

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        return scanpath(tracks, self._plan(tracks))

    def _plan(self, tracks: Tracks) -> Plan:
        s, state = self.settings, self._state
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
            self._aim,
            confirm=s.confirm,
            patience=s.patience,
            horizon=s.horizon,
        )
        self._state = replace(state, pursuit=pursuit)
        return plan
