"""Aims a camera between two frames: full field or one window, by writes or by stored sets."""

from collections.abc import Iterator
from typing import Protocol

from drivers.genicam.device import Device
from drivers.genicam.foveation import AXES, OFFSETS, Foveation
from pipeline.errors import DriverError

Offset = tuple[int, int]  # x, y of a window in sensor pixels
MOST_SETS = 256  # each takes about ten transactions when the camera is opened


class Steering(Protocol):
    """How the next frame is aimed."""

    step_px: int  # windows start at multiples of it

    def prepare(self) -> None:
        """Once, before the camera exposes."""
        ...

    def aim(self, offset: Offset | None) -> None:
        """The next frame shows the window at `offset`; None: the whole field, reduced."""
        ...


class Writes:
    """Writes what differs from the last frame: reduction and offsets."""

    def __init__(self, device: Device, can: Foveation, factor: int, step_px: int) -> None:
        self._device, self._can, self._factor = device, can, factor
        self.step_px = step_px
        self._written: dict[str, int | str] = {}

    def prepare(self) -> None:
        """Nothing is stored in the camera."""

    def aim(self, offset: Offset | None) -> None:
        """Write offsets before a coarser reduction, and after a finer one: both stay in range."""
        for name, value in _features(self._can, self._factor, offset):
            if self._written.get(name) != value:
                self._written.pop(name, None)  # unknown until the camera has acknowledged
                self._device.put(name, value)
                self._written[name] = value


class Sets:
    """Stores the whole field and a grid of windows as sequencer sets, and loads one per frame.

    The number of sets limits the grid: windows start at multiples of a coarse step.
    """

    def __init__(
        self, device: Device, can: Foveation, factor: int, *, step_px: int, free_px: tuple[int, int]
    ) -> None:
        self._device, self._can, self._factor = device, can, factor
        sets = min(can.sets, MOST_SETS)
        if sets < 2:
            raise DriverError(f"{device.key}: expected at least 2 sequencer sets, got {sets}")
        self.step_px = grid_step(free_px, step_px, sets - 1)
        self._offsets: list[Offset | None] = [None, *_grid(free_px, self.step_px)]
        self._index = {offset: i for i, offset in enumerate(self._offsets)}

    def prepare(self) -> None:
        """Store all sets; the camera must not expose."""
        device = self._device
        if device.has("SequencerMode"):
            device.write("SequencerMode", "Off")
        device.write("SequencerConfigurationMode", "On")
        self._enable()
        for index, offset in enumerate(self._offsets):
            device.put("SequencerSetSelector", index)
            for name, value in _features(self._can, self._factor, offset):
                device.put(name, value)
            device.execute("SequencerSetSave")

    def aim(self, offset: Offset | None) -> None:
        """Load a set; raises `DriverError` for a window that is none of the grid."""
        if offset not in self._index:
            raise DriverError(f"{self._device.key}: expected a window of the grid, got {offset}")
        self._device.put("SequencerSetSelector", self._index[offset])
        self._device.execute("SequencerSetLoad")

    def _enable(self) -> None:
        if not self._device.has("SequencerFeatureEnable"):
            return
        for name, _ in _features(self._can, self._factor, None):
            self._device.put("SequencerFeatureSelector", name)
            self._device.write("SequencerFeatureEnable", True)


def grid_step(free_px: tuple[int, int], step_px: int, windows: int) -> int:
    """The smallest multiple of `step_px` whose grid has at most `windows` windows.

    >>> grid_step((1000, 600), 8, 127)
    72
    """
    step = step_px
    while (free_px[0] // step + 1) * (free_px[1] // step + 1) > windows:
        step += step_px
    return step


def _grid(free_px: tuple[int, int], step_px: int) -> Iterator[Offset]:
    return (
        (x, y) for y in range(0, free_px[1] + 1, step_px) for x in range(0, free_px[0] + 1, step_px)
    )


def _features(can: Foveation, factor: int, offset: Offset | None) -> list[tuple[str, int | str]]:
    """Features of a frame in the order in which they stay within their ranges."""
    level = factor if offset is None else 1
    reduction: list[tuple[str, int | str]] = []
    for axis in AXES:
        name = can.reduction + axis
        reduction.append((name, can.entries.get(name, {}).get(level, level)))
    offsets: list[tuple[str, int | str]] = list(zip(OFFSETS, offset or (0, 0), strict=True))
    return [*offsets, *reduction] if offset is None else [*reduction, *offsets]
