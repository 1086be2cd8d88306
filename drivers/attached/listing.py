"""What a search found: sensors of one kind, or the reason why they were not looked for."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Offer:
    """One format that a sensor can send."""

    pixel_format: str  # as its `pixel_format` or `fourcc` is set
    size_px: tuple[int, int] = (0, 0)  # width, height; 0: not told
    rates_hz: tuple[float, ...] = ()  # the possible ones; of a `range`, the lowest and highest
    ranged: bool = False


@dataclass(frozen=True, kw_only=True)
class AttachedSensor:
    """One device, as far as it tells."""

    name: str  # what `fovea sensors test` takes
    title: str  # maker, model
    where: str = ""  # bus, address, path
    offers: tuple[Offer, ...] = ()
    modes: tuple[str, ...] = ()  # ways in which it can be run
    context_px: tuple[int, int] = (0, 0)  # of a sensor that foveates; 0: told once it is open
    roi_sizes_px: tuple[tuple[int, int], ...] = ()
    foveates: bool = False
    foveation: str = ""  # how it foveates, or why it does not
    run: str = ""  # the command that runs a graph on it
    problem: str = ""  # why it cannot be used now, in one sentence
    remedy: str = ""


@dataclass(frozen=True, kw_only=True)
class KindFound:
    """What the search for one kind found."""

    kind: str
    what: str  # the kind, in words
    sensors: tuple[AttachedSensor, ...] = ()
    missing: str = ""  # what is not installed, and the command: this kind was not looked for
    problem: str = ""  # why the search failed
    seconds: float = 0.0
