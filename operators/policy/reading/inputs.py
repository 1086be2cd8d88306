"""What policies share that show texts until they are read.

The reader reports what it has read as a `Percept`: a track that a sure reading covers is worth
nothing more. `roi` tells which window was exposed; without it, the policy takes its own plans for
granted.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import check_horizon
from operators.policy.inputs import PolicyInputs
from operators.policy.looks import Looks, carried, exposed, no_looks, noted
from operators.policy.memory import Memory, blank
from operators.policy.utility import windows
from pipeline import (
    Frame,
    Header,
    Percept,
    SettingsError,
    Tracks,
)

LATE = 16  # frames for which a window that is not reported is taken from the plan


@dataclass(frozen=True, kw_only=True)
class TextPolicySettings:
    """What a graph may set of each of them."""

    horizon: int = 16  # Tp, frames planned
    sure: float = 0.8  # score of a reading from which a text counts as read
    delay: int = 0  # frames by which plans come late: windows of those are commanded already

    def __post_init__(self) -> None:
        check_horizon(self.horizon)
        if not 0 <= self.delay < self.horizon:
            raise SettingsError(
                f"delay: expected 0 to below the horizon of {self.horizon}, got {self.delay}"
            )
        if not 0 < self.sure <= 1:
            raise SettingsError(f"sure: expected above 0 to 1, got {self.sure}")


@dataclass(frozen=True, kw_only=True, eq=False)
class TextPolicyState:
    """State between frames; immutable."""

    looks: Looks
    roi_seq: int  # last frame whose window was reported, -1: none yet
    planned: NDArray[np.float32]  # (t, 4) windows commanded for the frames from `first_seq` on
    first_seq: int
    memory: Memory  # of the features that the ROI showed; only the learned policy fills it


def at_first() -> TextPolicyState:
    """Return the state before the first frame."""
    return TextPolicyState(
        looks=no_looks(),
        roi_seq=-1,
        planned=np.zeros((0, 4), np.float32),
        first_seq=0,
        memory=blank(),
    )


S = TypeVar("S", bound=TextPolicySettings)


class TextPolicy(PolicyInputs[S]):
    """Inputs and inhibition of return; a class for one strategy implements `on_tracks`."""

    live = ("sure",)

    def open(self) -> None:
        """Start without looks."""
        self._state = at_first()

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other texts."""
        self._state = at_first()

    def state(self) -> TextPolicyState:
        """Return what was shown and read."""
        return self._state

    def restore(self, state: TextPolicyState) -> None:
        """Take over what another instance has shown, and what was read."""
        self._state = state

    def on_percept(self, percept: Percept) -> None:
        """Note what has been read; raises `MessageError` for texts that do not fit the boxes."""
        self._state = noted_reading(self._state, percept)

    def on_roi(self, roi: Frame) -> None:
        """Note what the ROI showed."""
        window = np.array(roi.window, np.float32)
        self._state = shown_window(self._state, window, roi.header.seq)


def noted_reading(state: TextPolicyState, percept: Percept) -> TextPolicyState:
    """Return the state after the reader reported."""
    return replace(state, looks=noted(state.looks, percept))


def shown_window(state: TextPolicyState, window: NDArray[np.float32], seq: int) -> TextPolicyState:
    """Return the state after `window` (4,) was exposed in frame `seq`; zeros: none was."""
    looks = exposed(state.looks, window, seq) if window.any() else state.looks
    return replace(state, looks=looks, roi_seq=seq)


def brought_up(state: TextPolicyState, tracks: Tracks, delay: int) -> tuple[TextPolicyState, Looks]:
    """Return the state of these tracks, and the looks expected when a plan takes effect.

    Windows that are not reported yet, and those of the `delay` frames that a plan is too late for,
    are taken from earlier plans.
    """
    seq = tracks.header.seq
    state = replace(state, looks=carried(state.looks, tracks))
    if state.roi_seq < 0:  # nothing reports windows, or not yet
        state = replace(state, looks=_foreseen(state, range(seq, seq + 1)))
        return state, _foreseen(state, range(seq + 1, seq + 1 + delay))
    awaited = max(state.roi_seq + 1, seq - LATE)
    return state, _foreseen(state, range(awaited, seq + 1 + delay))


def _foreseen(state: TextPolicyState, frames: range) -> Looks:
    """Return the looks after the windows commanded for these frames."""
    looks = state.looks
    for frame in frames:
        if 0 <= (row := frame - state.first_seq) < len(state.planned):
            looks = exposed(looks, state.planned[row], frame)
    return looks


def planned(
    state: TextPolicyState, tracks: Tracks, boxes: NDArray[np.float32], delay: int
) -> TextPolicyState:
    """Return the state after a plan to look at `boxes` (Tp, 4) in the frames after this one.

    The first `delay` of its windows come too late; those of earlier plans hold.
    """
    first = tracks.header.seq + 1
    commanded = windows(boxes, tracks.header.geometry)
    row = first - state.first_seq
    held = state.planned[row : row + delay] if row >= 0 else state.planned[:0]
    commanded[: len(held)] = held
    return replace(state, planned=commanded, first_seq=first)
