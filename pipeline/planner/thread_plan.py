"""Choose threads and provider of every network: measured ways in, the cheapest that keeps the rate.

A stage has to answer within the time between two frames, and each is chosen on its own. Where all
of them together need more cores than there are, a faster way of one only takes time from the others
(the whole pitch on two cores: p99 +37 %, drops +22 %); then the cheapest way of each is chosen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

SAME, SAME_MS = 0.05, 0.2  # share and ms of a call: what saves less is no reason for a change


@dataclass(frozen=True, kw_only=True)
class Way:
    """One way to run a stage, with what it took: milliseconds of one call."""

    threads: int
    provider: str  # empty: the stage has no such setting
    wall_ms: float  # p90
    cpu_ms: float  # of all threads, mean

    @property
    def told(self) -> str:
        """Threads and provider, as a cell."""
        return ", ".join(filter(None, [f"{self.threads} thread{'s' * (self.threads != 1)}",
                                       self.provider]))  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What is proposed for a stage."""

    now: Way
    chosen: Way
    in_time: bool  # whether it answers between two frames

    @property
    def changed(self) -> bool:
        """Whether anything is to be set."""
        return self.chosen is not self.now


def choose(now: Way, ways: Sequence[Way], rate_hz: float) -> Choice:
    """Return the cheapest way that answers in time; the fastest one where none does.

    What the graph has stays, unless it is too slow or something else saves more than the margins.
    """
    period_ms = 1000 / rate_hz
    fast = [way for way in (now, *ways) if way.wall_ms <= period_ms]
    if not fast:
        best = min((now, *ways), key=lambda way: (way.wall_ms, way.cpu_ms))
        return Choice(now=now, chosen=best, in_time=False)
    best = min(fast, key=lambda way: (way.cpu_ms, way.wall_ms))
    if now in fast and now.cpu_ms <= best.cpu_ms + max(SAME_MS, SAME * best.cpu_ms):
        best = now
    return Choice(now=now, chosen=best, in_time=True)


def cheapest(now: Way, ways: Sequence[Way], rate_hz: float) -> Choice:
    """Return the way with the least processor time; what the graph has, unless it costs more."""
    best = min((now, *ways), key=lambda way: (way.cpu_ms, way.wall_ms))
    if now.cpu_ms <= best.cpu_ms + max(SAME_MS, SAME * best.cpu_ms):
        best = now
    return Choice(now=now, chosen=best, in_time=best.wall_ms <= 1000 / rate_hz)


def choose_all(
    measured: Mapping[str, tuple[Way, Sequence[Way]]], others_ms: float, rate_hz: float,
    cores: float,
) -> dict[str, Choice]:  # fmt: skip
    """Return a choice by stage; `measured`: what it has, and the other ways."""
    found = {name: choose(now, ways, rate_hz) for name, (now, ways) in measured.items()}
    if cores_needed(others_ms, found, rate_hz) <= cores:
        return found
    return {name: cheapest(now, ways, rate_hz) for name, (now, ways) in measured.items()}


def cores_needed(others_ms: float, choices: Mapping[str, Choice], rate_hz: float) -> float:
    """Return how many cores the work keeps busy; `others_ms`: of a frame, what is not chosen."""
    spent_ms = others_ms + sum(choice.chosen.cpu_ms for choice in choices.values())
    return spent_ms * rate_hz / 1000
