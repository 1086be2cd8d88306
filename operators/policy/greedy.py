"""A policy that shows everybody again and again: Tracks and RoiFeatures -> Scanpath.

It looks where a window is expected to gain most. An object inside gains the more, the longer ago
the ROI showed it and the less certain it is who it is: it began, was found again after a gap, or
overlapped another one, and has not been shown often enough since. One window may show several.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import (
    PLACE,
    GazePlan,
    field_centre,
    future,
    of_class,
    scanpath,
    stay,
)
from operators.policy.of_class import ClassPolicy, ClassPolicySettings
from pipeline import (
    Geometry,
    Header,
    RoiFeatures,
    Scanpath,
    SettingsError,
    Tracks,
)
from pipeline.boxes import areas, centres, covered, in_parts, intersections, iou

NEW_AGE = 25  # frames since the last look, for an object that was never shown
MOST_AGE = 250  # frames: an older look makes no difference
GAP = 2  # frames without detection after which it is in doubt who a track is
OVERLAP = 0.3  # IoU from which two objects may be confused
INSIDE = 0.8  # share of an object that a window must show


@dataclass(frozen=True, kw_only=True)
class GreedyPolicySettings(ClassPolicySettings):
    """What a graph may set."""

    doubt: float = 4.0  # weight of an object in doubt, beside 1 of others
    looks: int = 4  # that end a doubt
    delay: int = 0  # frames by which plans come late: windows of those are commanded already

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.looks < 1:
            raise SettingsError(f"looks: must be at least 1, got {self.looks}")
        if not 0 <= self.delay < self.horizon:
            raise SettingsError(
                f"delay: expected 0 to below the horizon of {self.horizon}, got {self.delay}"
            )
        if not 0 <= self.doubt <= 1000:
            raise SettingsError(f"doubt: expected 0 to 1000, got {self.doubt}")


@dataclass(frozen=True, kw_only=True, eq=False)
class GreedyState:
    """What was shown of each current track (n), and the windows commanded: immutable."""

    ids: NDArray[np.int32]  # (n,)
    shown_seq: NDArray[np.int64]  # (n,), when the ROI showed it last
    aimed_seq: NDArray[np.int64]  # (n,), the same of windows planned since, whatever they will show
    looks: NDArray[np.int64]  # (n,), since the last doubt
    seen_seq: NDArray[np.int64]  # (n,), when it was detected last
    windows: NDArray[np.float32]  # (m, 4), of the frames from `first_seq` on, which are commanded
    first_seq: int


def none_shown() -> GreedyState:
    """Return the state before the first frame."""
    whole = np.zeros(0, np.int64)
    return GreedyState(
        ids=np.zeros(0, np.int32), shown_seq=whole, aimed_seq=whole, looks=whole, seen_seq=whole,
        windows=np.zeros((0, 4), np.float32), first_seq=0,
    )  # fmt: skip


class GreedyPolicy(ClassPolicy[GreedyPolicySettings]):
    """Plans are windows, not objects; the probability of an object is its share of the gain.

    Without objects, it looks at the middle of the field.
    """

    def open(self) -> None:
        """Start without looks."""
        super().open()
        self._state = none_shown()

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other objects."""
        self._state = none_shown()

    def state(self) -> GreedyState:
        """Return what was shown."""
        return self._state

    def restore(self, state: GreedyState) -> None:
        """Take over what another instance has shown."""
        self._state = state

    def on_features(self, features: RoiFeatures) -> None:
        """Note whom the ROI showed, and that it did not show others that were aimed at."""
        self._state = noted(self._state, features.ids, features.header.seq)

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        s, self._names = self.settings, tracks.names
        now = brought_up(self._state, tracks)
        boxes = np.concatenate([tracks.boxes[:, -1:], tracks.predicted], axis=1)
        fit = of_class(tracks, s.target) & np.isfinite(boxes).all(axis=(1, 2))
        plan, self._state = greedy(tracks, now, fit, s)
        return scanpath(tracks, plan)


def noted(state: GreedyState, ids: NDArray[np.int32], seq: int) -> GreedyState:
    """Return the state after the ROI of frame `seq` showed these tracks (m,)."""
    shown = np.isin(state.ids, ids)
    return replace(
        state,
        shown_seq=np.where(shown, np.maximum(state.shown_seq, seq), state.shown_seq),
        aimed_seq=np.where(state.aimed_seq <= seq, -1, state.aimed_seq),
        looks=state.looks + shown,
    )


def brought_up(state: GreedyState, tracks: Tracks) -> GreedyState:
    """Return the state of these tracks: new ones begin, and doubts begin anew."""
    seq, row = tracks.header.seq, {int(i): k for k, i in enumerate(state.ids)}
    before = np.array([row.get(int(i), -1) for i in tracks.ids], np.int64)
    old, visible = before >= 0, tracks.visible[:, -1]

    def kept(column: NDArray[np.int64], new: int) -> NDArray[np.int64]:
        return np.where(old, np.append(column, new)[before], new)

    seen_seq = kept(state.seen_seq, seq)
    found_again = visible & (seq - seen_seq > GAP)
    doubted = found_again | overlapped(tracks)
    return replace(
        state,
        ids=tracks.ids,
        shown_seq=kept(state.shown_seq, seq - NEW_AGE),
        aimed_seq=kept(state.aimed_seq, -1),
        looks=np.where(doubted, 0, kept(state.looks, 0)),
        seen_seq=np.where(visible, seq, seen_seq),
    )


def overlapped(tracks: Tracks) -> NDArray[np.bool_]:
    """Return which tracks overlap another one now: (n,)."""
    boxes = tracks.boxes[:, -1]
    shared = iou(boxes, boxes)
    np.fill_diagonal(shared, 0)
    return np.asarray((shared >= OVERLAP).any(axis=1))


def greedy(
    tracks: Tracks, state: GreedyState, fit: NDArray[np.bool_], s: GreedyPolicySettings
) -> tuple[GazePlan, GreedyState]:
    """Return the plan, and the state in which its first window is aimed.

    Each frame of the plan counts what the frames before it will have shown. Frames that the plan is
    too late for have the windows of earlier plans.
    """
    geometry, seq = tracks.header.geometry, tracks.header.seq
    windowed = geometry.roi_width_px > 0 and geometry.roi_height_px > 0  # unknown of some sources
    if not (windowed and fit.any()):
        return stay(field_centre(geometry), s.horizon), state
    ahead = np.stack([future(tracks, row, s.horizon) for row in range(len(tracks.ids))], axis=1)
    shown_seq, looks = np.maximum(state.shown_seq, state.aimed_seq), state.looks
    useless = overlapped(tracks)  # who is who is seen when they are apart
    boxes = np.zeros((s.horizon, 4), np.float32)
    probability = np.zeros((s.horizon, len(tracks.ids)), np.float32)
    for step in range(s.horizon):
        age = np.clip(seq + 1 + step - shown_seq, 0, MOST_AGE)
        gain = worth(age, looks, useless, s) * fit
        row = seq + 1 + step - state.first_seq
        if step < s.delay and 0 <= row < len(state.windows):
            window = state.windows[row]
            inside = covered(ahead[step], window) >= INSIDE
        else:
            window, inside = best_window(ahead[step], gain, geometry)
        boxes[step], probability[step] = window, gain / max(gain.sum(), 1e-9)
        shown_seq, looks = np.where(inside, seq + 1 + step, shown_seq), looks + inside
        if step == 0:
            aimed_seq = np.where(inside, seq + 1, state.aimed_seq)
    choice = np.full(s.horizon, PLACE, np.int32)
    state = replace(state, aimed_seq=aimed_seq, windows=boxes[1 : s.delay + 1], first_seq=seq + 2)
    return GazePlan(choice=choice, boxes=boxes, probability=probability), state


def worth(
    age: NDArray[np.int64],
    looks: NDArray[np.int64],
    useless: NDArray[np.bool_],
    s: GreedyPolicySettings,
) -> NDArray[np.float64]:
    """Return what a look at each object is worth (n,): frames since the last one, by the doubt.

    `looks` are those since the doubt began; where a look is `useless`, no doubt counts.
    """
    doubt = 1 + s.doubt * np.clip(1 - looks / s.looks, 0, 1)
    return np.asarray(age * np.where(useless, 1, doubt), np.float64)


def best_window(
    boxes: NDArray[np.float32], gain: NDArray[np.float64], geometry: Geometry
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the window (4,) of the greatest gain, and which boxes (n, 4) it shows: (n,).

    Tried are windows around each object and between any two that fit in one.
    """
    middle = centres(boxes)
    one, other = np.triu_indices(len(boxes))
    roi = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    fits = (np.abs(middle[one] - middle[other]) < roi).all(axis=1)
    places = (middle[one[fits]] + middle[other[fits]]) / 2
    field = np.array([geometry.width_px, geometry.height_px], np.float32)
    corners = np.clip(np.rint(places - roi / 2), 0, field - roi)
    corners -= corners % geometry.step_px  # as the sensor addresses them
    windows = np.concatenate([corners, corners + roi], axis=1)
    least = INSIDE * np.maximum(areas(boxes), 1e-9)
    shown = [(intersections(part, boxes) >= least) @ gain for part in in_parts(windows, len(boxes))]
    best = windows[int(np.concatenate(shown).argmax())]
    return best, np.asarray(intersections(best[None], boxes)[0] >= least)
