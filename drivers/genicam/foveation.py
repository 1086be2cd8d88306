"""Whether and how a camera can foveate: its node map in, a verdict with the reason out.

A camera foveates when it can show, in turn and while it streams, its full field (reduced by binning
or decimation) and a window of the same number of pixels at full resolution, wherever the window is.
Both pictures then have the same size, so that the payload is constant. Features are named by the
Standard Features Naming Convention (SFNC 2.7, chapters 4 to 6 and 18).

A feature that must not change while images are transferred is locked by `TLParamsLocked`; its
`pIsLocked` tells. Where a register decides this, only the camera knows: `unsure` names the feature.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.genicam.formula import Number, Values
from drivers.genicam.nodes import NodeMap
from drivers.genicam.values import NodeValues, unknown
from pipeline.text import harmless

STREAMING = {"TLParamsLocked": 1}
REDUCTIONS = ("Binning", "Decimation")
AXES = ("Horizontal", "Vertical")
OFFSETS = ("OffsetX", "OffsetY")
MOST_FACTOR = 32


@dataclass(frozen=True, kw_only=True)
class Foveation:
    """How a camera can foveate. Zeros are what only the connected camera tells."""

    means: str = ""  # writes: features between frames; sequencer: stored sets; empty: it cannot
    reason: str = ""  # why it cannot, in one sentence
    unsure: tuple[str, ...] = ()  # features of which only the camera knows whether they are locked
    reduction: str = ""  # Binning | Decimation
    factors: tuple[int, ...] = ()  # of the reduction, both axes alike; empty: told by the camera
    field_px: tuple[int, int] = (0, 0)  # width, height of the whole field
    size_step_px: tuple[int, int] = (0, 0)  # steps of width and height
    offset_step_px: tuple[int, int] = (0, 0)
    rates_hz: tuple[float, float] = (0.0, 0.0)  # of single frames; an exposure takes two
    sets: int = 0  # of the sequencer
    entries: Mapping[str, Mapping[int, str]] = field(default_factory=dict)  # factor -> its name

    def roi_sizes_px(self) -> tuple[tuple[int, int], ...]:
        """Sizes of context and ROI by factor; none where field or steps are not known."""
        if not (all(self.field_px) and all(self.size_step_px)):
            return ()
        sizes = (reduced(self.field_px, factor, self.size_step_px) for factor in self.factors)
        return tuple(size for size in sizes if all(size))


def reduced(field_px: tuple[int, int], factor: int, step_px: tuple[int, int]) -> tuple[int, int]:
    """Size of the field divided by a factor, down to whole steps.

    >>> reduced((3096, 2080), 4, (8, 2))
    (768, 520)
    """
    width, height = (
        side // factor // step * step for side, step in zip(field_px, step_px, strict=True)
    )
    return width, height


def plain_hint(camera: str) -> str:
    """The options that run a camera as a plain one.

    >>> plain_hint("S7")
    'run it as a plain camera: sensor: drivers.cameras:CameraSensor, options: {camera: \
"drivers.genicam:GenicamCamera", camera_options: {camera: "S7"}}'
    """
    own = f', camera_options: {{camera: "{harmless(camera, 60)}"}}' if camera else ""
    options = f'{{camera: "drivers.genicam:GenicamCamera"{own}}}'
    return f"run it as a plain camera: sensor: drivers.cameras:CameraSensor, options: {options}"


def foveation(found: NodeMap, read: Values = unknown) -> Foveation:
    """Judge a camera by its description, and by its registers where it is connected."""
    values = NodeValues(found, read=read, given=STREAMING)
    reason = _unaimed(found, values)
    if reason:
        return Foveation(reason=reason)
    writes = _by_writes(found, values)
    if writes.means:
        return writes
    sets = _by_sequencer(found, values)
    if sets.means:
        return sets
    return Foveation(reason=f"{writes.reason}; {sets.reason}")


def _unaimed(found: NodeMap, values: NodeValues) -> str:
    """Why the camera cannot take one aimed frame after the other; empty: it can."""
    for name in ("Width", "Height", *OFFSETS):
        if not values.there(name):
            return f"{name} is missing: it has no window to move"
    for name in ("TriggerSoftware", "TriggerMode", "TriggerSource"):
        if not values.there(name):
            return f"{name} is missing: no frame can be asked for after its window was set"
    source = found.get("TriggerSource")
    if source is not None and "Software" not in source.entries:
        return "TriggerSource has no entry Software: no frame can be asked for by the host"
    return ""


def _by_writes(found: NodeMap, values: NodeValues) -> Foveation:
    """Full field and window by writing features between frames."""
    for name in OFFSETS:
        if values.locked(name):
            return Foveation(reason=f"offset cannot move while it streams ({name} is locked)")
    told = []
    for reduction in REDUCTIONS:
        names = tuple(reduction + axis for axis in AXES)
        if not all(values.there(name) for name in names):
            told.append(f"it has no {names[0]} and {names[1]}")
            continue
        blocked = [name for name in names if values.locked(name)]
        if blocked:
            told.append(f"{blocked[0]} is locked while it streams")
            continue
        unsure = tuple(n for n in (*names, *OFFSETS) if values.locked(n) is None)
        return _described(found, values, "writes", reduction, unsure)
    return Foveation(reason=f"the full field cannot be seen between two ROIs: {', '.join(told)}")


def _by_sequencer(found: NodeMap, values: NodeValues) -> Foveation:
    """Full field and window by stored sets that the host loads between frames.

    SFNC: `SequencerSetLoad` changes the device's state to the set that `SequencerSetSelector`
    names, also while `SequencerMode` is off.
    """
    needed = ("SequencerFeatureSelector", "SequencerSetSelector", "SequencerSetSave",
              "SequencerSetLoad", "SequencerConfigurationMode")  # fmt: skip
    missing = [name for name in needed if not values.there(name)]
    if missing:
        told = "it has no sequencer" if len(missing) == len(needed) else f"it lacks {missing[0]}"
        return Foveation(reason=told)
    for name in ("SequencerSetSelector", "SequencerSetLoad", "SequencerConfigurationMode"):
        if values.locked(name):
            return Foveation(reason=f"its sequencer cannot be aimed while it streams ({name})")
    selector = found.get("SequencerFeatureSelector")
    stored = selector.entries if selector is not None else {}
    absent = [name for name in OFFSETS if name not in stored]
    if absent:
        return Foveation(reason=f"its sequencer does not store {absent[0]}")
    for reduction in REDUCTIONS:
        names = tuple(reduction + axis for axis in AXES)
        if all(name in stored and values.there(name) for name in names):
            unsure = tuple(n for n in needed[1:] if values.locked(n) is None)
            return _described(found, values, "sequencer", reduction, unsure)
    return Foveation(reason="its sequencer stores neither binning nor decimation")


def _described(
    found: NodeMap, values: NodeValues, means: str, reduction: str, unsure: tuple[str, ...]
) -> Foveation:
    names = [reduction + axis for axis in AXES]
    entries = {name: _entries(found, name) for name in names}
    ranges = [_factors(values, name, entries[name]) for name in names]
    rate = values.limits("AcquisitionFrameRate")
    sets = values.limits("SequencerSetSelector")
    return Foveation(
        means=means,
        unsure=unsure,
        reduction=reduction,
        factors=tuple(sorted(set(ranges[0]) & set(ranges[1]) - {1})),
        field_px=(_size(values, "Width"), _size(values, "Height")),
        size_step_px=(_step(values, "Width"), _step(values, "Height")),
        offset_step_px=(_step(values, "OffsetX"), _step(values, "OffsetY")),
        rates_hz=(_amount(rate.low), _amount(rate.high)),
        sets=_count(sets.high) + 1 if means == "sequencer" and sets.high is not None else 0,
        entries=entries,
    )


def _entries(found: NodeMap, name: str) -> dict[int, str]:
    """Factor -> entry of an enumeration such as BinningHorizontal2; empty for a number."""
    node = found.get(name)
    numbered = {entry: re.search(r"(\d{1,2})$", entry) for entry in (node.entries if node else ())}
    return {int(match[1]): entry for entry, match in numbered.items() if match}


def _factors(values: NodeValues, name: str, entries: Mapping[int, str]) -> tuple[int, ...]:
    if entries:
        return tuple(entries)
    high = values.limits(name).high
    return tuple(range(1, min(_count(high), MOST_FACTOR) + 1))


def _size(values: NodeValues, side: str) -> int:
    """Pixels of the whole field along one side, as far as the text or the camera tells."""
    return _count(values.value(f"Sensor{side}")) or _count(values.value(f"{side}Max"))


def _step(values: NodeValues, name: str) -> int:
    return _count(values.limits(name).step)


def _count(number: Number | None) -> int:
    return int(number) if number is not None and 0 < number < 1 << 20 else 0


def _amount(number: Number | None) -> float:
    return float(number) if number is not None and 0 < number < 1e9 else 0.0
