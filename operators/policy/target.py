"""The target of a prompt (a box, a track id or a class), tracked over time.

A target is bound to a track and follows it. When the track ends, its position moves with the camera
or with its carrier (`carrier.py`) until it is bound again, to the policy's own choice.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.policy.carrier import PEOPLE, can_carry, carrier_of
from operators.policy.gaze_plan import PLACE, row_of
from operators.policy.motion import camera_motion
from operators.policy.tokens import Array
from pipeline import Geometry, SettingsError, Tracks
from pipeline.boxes import centres, from_centres, iou, sizes
from pipeline.contract import BEFORE
from pipeline.errors import FoveaError

BIND_IOU = 0.1
ALIKE = 2.0  # without overlap, a near box binds if sides differ by less than this factor
SURE = 0.5  # probability from which a choice binds the target
GROWTH = 0.1  # box sizes per frame by which the uncertainty grows
CARRIED_AFTER = 2  # detections at the same person before it counts as the carrier
MOST_LISTED = 100  # class names in a sentence
LONGEST_NAME = 100  # characters
CARRIED_AT_MOST = 250  # frames without a detection: ten seconds; a keeper may hold a ball for eight


@dataclass(frozen=True, kw_only=True)
class TargetSpec:
    """The prompt: an id, else the object in a box, else a class; without any: any object."""

    object_id: int = -1
    box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor pixels
    label: str = ""  # class name
    carriers: tuple[str, ...] = PEOPLE  # classes that may carry it

    @property
    def one(self) -> bool:
        """Whether the prompt means one object, not any of a class."""
        return self.object_id >= 0 or self.boxed

    @property
    def boxed(self) -> bool:
        """Whether a box determines the object; an id takes precedence."""
        return self.object_id < 0 and self.box[2] > self.box[0]


def _nowhere() -> Array:
    return np.zeros(4, np.float32)


@dataclass(frozen=True, kw_only=True)
class TargetSettings:
    """What a graph may set of a target: `target_id`, else `prompt_box`, else class `target`."""

    target: str = ""  # class name (ball, referee, player …); empty: any
    target_id: int = -1  # track id
    prompt_box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor pixels
    carriers: tuple[str, ...] = PEOPLE  # classes of people, who may carry what is out of sight

    def __post_init__(self) -> None:
        check_box("prompt_box", self.prompt_box)

    @property
    def spec(self) -> TargetSpec:
        """The target."""
        return TargetSpec(
            object_id=self.target_id,
            box=self.prompt_box,
            label=self.target,
            carriers=self.carriers,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetState:
    """The state of the target."""

    bound_id: int = -1  # the target's track
    label: str = ""  # its class, once known
    asked_seq: int = -1  # the first frame after the prompt; -1: not yet
    at_seq: int = -1  # the frame of this state
    seen_seq: int = -1  # when it was last seen, or asked for; -1: neither yet
    box: Array = field(default_factory=_nowhere)  # estimated box, sensor pixels
    features: Array = field(default_factory=lambda: np.zeros(0, np.float32))  # (C,) when bound
    carrier_id: int = -1  # the person it was last seen at
    carried_count: int = 0  # consecutive detections there
    offset: Array = field(default_factory=lambda: np.zeros(2, np.float32))  # from their middle, px

    @property
    def is_carried(self) -> bool:
        """Whether it counts as carried."""
        return self.carrier_id >= 0 and self.carried_count >= CARRIED_AFTER

    @property
    def placed(self) -> bool:
        """Whether a position is known."""
        return bool(self.box[2] > self.box[0])


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The policy's choice for one frame."""

    object_id: int = PLACE
    probability: float = 0.0


def follow(before: TargetState, spec: TargetSpec, tracks: Tracks, chosen: Choice) -> TargetState:
    """Return the target after one more frame, for which the policy had chosen `chosen`."""
    seq = tracks.header.seq
    frames = seq - before.at_seq if before.at_seq >= 0 else 1
    asked_seq = before.asked_seq if before.asked_seq >= 0 else seq
    now = replace(before, asked_seq=asked_seq, at_seq=seq)
    if now.seen_seq < 0 and spec.boxed:
        now = replace(now, box=np.array(spec.box, np.float32), seen_seq=seq)
        now = replace(_taken(now, spec, spec.label, tracks), carried_count=CARRIED_AFTER)
    elif now.placed:
        now = replace(now, box=_moved(now, tracks, frames))
    row = row_of(tracks, now.bound_id)
    if row < 0 or (not spec.one and chosen.probability >= SURE):
        found = _first(tracks, spec, now) if now.bound_id < 0 else -1
        found = found if found >= 0 else _again(tracks, spec, now, chosen)
        row = found if found >= 0 else row
    return _bound(tracks, row, now, spec) if row >= 0 else now


def carrier_row(target: TargetState, tracks: Tracks) -> int:
    """Return the row of the carrier of an unseen target, -1: none."""
    row = row_of(tracks, target.bound_id)
    seen = row >= 0 and tracks.visible[row, -1]
    late = tracks.header.seq - target.seen_seq > CARRIED_AT_MOST
    return -1 if seen or late or not target.is_carried else row_of(tracks, target.carrier_id)


def check_box(name: str, box: tuple[float, float, float, float]) -> None:
    """Raise `SettingsError` unless these are left, top, right and bottom of a box, or all 0."""
    left, top, right, bottom = box
    if any(box) and not (left < right and top < bottom):
        raise SettingsError(f"{name}: expected left, top, right, bottom, got {box}")


def check_label(label: str, names: Sequence[str]) -> None:
    """Raise `SettingsError` for a class that the tracks do not have."""
    if sentence := unknown_label(label, names):
        raise SettingsError(sentence)


def unknown_label(label: str, names: Sequence[str]) -> str:
    """Return a sentence for a class that the tracks do not have; empty if it is unknown yet."""
    if not label or not names or label in names:
        return ""
    more = f" … ({len(names) - MOST_LISTED} more)" if len(names) > MOST_LISTED else ""
    near = near_name(label, names)
    hint = f", did you mean {near!r}?" if near else ""
    return (
        f"policy.target: expected one of {', '.join(names[:MOST_LISTED])}{more}, "
        f"got {label[:LONGEST_NAME]}{hint}"
    )


def near_name(label: str, names: Sequence[str]) -> str:
    """Return the name that was probably meant, "" where none is near.

    >>> near_name("Ball", ["person", "sports ball"]), near_name("cat", ["person"])
    ('sports ball', '')
    """
    asked, known = label.lower()[:LONGEST_NAME], {name.lower(): name for name in names}
    near = difflib.get_close_matches(asked, known, 1, 0.6) or [n for n in known if asked in n]
    return known[near[0]] if near else ""


def told_before(name: str, upstream: Mapping[str, Any]) -> Any:
    """Return what the nearest settings that have it say, None where none do.

    `upstream` is that of `Operator.advise`. The settings of a detector have `reported_classes` and
    `feature_channels`; one whose weights are not there is reported by its own node.
    """
    for settings in upstream.get(BEFORE, ()):
        try:
            if (value := getattr(settings, name, None)) is not None:
                return value
        except FoveaError:
            return None
    return None


def check_known(label: str, upstream: Mapping[str, Any]) -> None:
    """Raise `SettingsError` for a class that the detector before this node does not report."""
    names = told_before("reported_classes", upstream) if label else None
    if sentence := unknown_label(label, names or ()):
        raise SettingsError(sentence.removeprefix("policy."))


def _moved(now: TargetState, tracks: Tracks, frames: int) -> Array:
    """Return the position `frames` later: at its carrier, else moved with the camera."""
    row = carrier_row(now, tracks)
    if row < 0:
        return now.box + frames * np.tile(camera_motion(tracks), 2)
    middle = centres(tracks.boxes[row, -1]) + now.offset
    return from_centres(middle, now.box[2:] - now.box[:2])


def _taken(now: TargetState, spec: TargetSpec, label: str, tracks: Tracks) -> TargetState:
    """Return the target detected at its box, with its possible carrier."""
    carrier_id = carrier_of(now.box, tracks, can_carry(tracks, spec.carriers, label))
    carried_count = now.carried_count + 1 if carrier_id == now.carrier_id else 1
    row = row_of(tracks, carrier_id)
    offset = centres(now.box) - centres(tracks.boxes[row, -1]) if row >= 0 else now.offset
    return replace(now, carrier_id=carrier_id, carried_count=carried_count, offset=offset)


def _first(tracks: Tracks, spec: TargetSpec, now: TargetState) -> int:
    """Return the row prompted by id or box, -1: missing."""
    if spec.object_id >= 0:
        return row_of(tracks, spec.object_id)
    if not spec.one or not len(tracks.ids):
        return -1
    return in_box(tracks.boxes[:, -1], now.box)


def in_box(boxes: Array, box: Array) -> int:
    """Return which of `boxes` (n, 4) `box` (4,) means: the greatest overlap, else the nearest.

    The nearest must be of similar size and within that distance; -1: none. A drawn prompt and a
    ball of a few pixels hardly overlap.
    """
    overlap = iou(boxes, box[None])[:, 0]
    if overlap.max() >= BIND_IOU:
        return int(overlap.argmax())
    away = np.linalg.norm(centres(boxes) - centres(box), axis=1)
    fit = (away <= _size(box)) & alike(boxes, box)
    return int(np.where(fit, away, np.inf).argmin()) if fit.any() else -1


def alike(boxes: Array, box: Array) -> NDArray[np.bool_]:
    """Return which of `boxes` (n, 4) are of similar size as `box` (4,): (n,)."""
    size, others = _size(box), sizes(boxes)
    return np.asarray(np.maximum(others / size, size / others) <= ALIKE)


def _again(tracks: Tracks, spec: TargetSpec, now: TargetState, chosen: Choice) -> int:
    """Return the row of the policy's own choice if it may be the target, else -1."""
    row = row_of(tracks, chosen.object_id)
    if row < 0 or chosen.probability < SURE or not tracks.visible[row, -1]:
        return -1
    wanted = now.label or spec.label
    if wanted and tracks.name_of(row) != wanted:
        return -1
    if now.bound_id < 0 and now.placed and not alike(tracks.boxes[row, -1][None], now.box)[0]:
        return -1  # of an unbound box only the size is known
    return row if not spec.one or _near(tracks, row, now) else -1


def _near(tracks: Tracks, row: int, now: TargetState) -> bool:
    """Whether the target can have moved there since its last detection."""
    if not now.placed:
        return False
    gone = tracks.header.seq - now.seen_seq
    away = float(np.linalg.norm(centres(tracks.boxes[row, -1]) - centres(now.box)))
    return away <= (1 + GROWTH * gone) * _size(now.box) + _reach(tracks.header.geometry)


def _size(box: Array) -> float:
    return float(sizes(box[None])[0])


def _reach(geometry: Geometry) -> float:
    """Return the distance an unseen target may have moved: a part of the ROI."""
    return 0.25 * geometry.roi_width_px


def _bound(tracks: Tracks, row: int, now: TargetState, spec: TargetSpec) -> TargetState:
    """Return the target bound to the track at `row`."""
    visible, label = bool(tracks.visible[row, -1]), now.label or tracks.name_of(row)
    if visible:
        now = _taken(replace(now, box=tracks.boxes[row, -1]), spec, label, tracks)
    elif not now.is_carried:  # a carried one stays with its carrier
        now = replace(now, box=tracks.boxes[row, -1])
    fresh = int(tracks.ids[row]) != now.bound_id
    first = fresh and not now.features.any()
    return replace(
        now,
        bound_id=int(tracks.ids[row]),
        label=label,
        seen_seq=tracks.header.seq if visible or now.seen_seq < 0 else now.seen_seq,
        features=tracks.features[row, -1].copy() if first else now.features,
    )
