"""What a graph has to show: the layout of the view follows from it."""

from typing import NamedTuple


class Shown(NamedTuple):
    """What a graph has to show, by which its task is known."""

    windows: int = 1  # of one exposure
    size_px: tuple[int, int] = (0, 0)  # of the sensor
    full: bool = False  # the whole field is known at full resolution, too
    acts: bool = False  # the consumer moves something
    reads: bool = False  # the consumer reads texts
    details: bool = False  # series of each stage and object
