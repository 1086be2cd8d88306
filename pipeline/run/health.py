"""Decide which process to kill, and why: stalled, too slow to open, or too much memory."""

import time
from collections.abc import Iterable

from pipeline.bus.ledger import Ledger
from pipeline.node.health import FROZEN_S, problem
from pipeline.run.managed_process import ManagedProcess

SLEPT_S = 1.0  # a longer gap between ticks means that the supervisor itself was stopped


class HealthMonitor:
    """Finds processes to replace; pauses after the supervisor itself was stopped."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._looked_s = time.monotonic()
        self._lenient_until_s = 0.0

    def tick(self) -> None:
        """Record that the supervisor runs; called more often than every `SLEPT_S`."""
        now_s = time.monotonic()
        if now_s - self._looked_s > SLEPT_S:
            self._lenient_until_s = now_s + FROZEN_S
        self._looked_s = now_s

    @property
    def ticked_ago_s(self) -> float:
        """Return the time since the last tick, in seconds."""
        return time.monotonic() - self._looked_s

    def problem(self, managed: ManagedProcess) -> str:
        """Return why its process must be killed, or an empty string."""
        now_s = time.monotonic()
        asleep = now_s - self._looked_s > SLEPT_S or now_s < self._lenient_until_s
        if managed.handle is None or asleep:
            return ""
        if frozen := stopped(managed, now_s):
            return frozen
        if managed.handle.deaf:
            return "does not read what it is told"
        if not managed.handle.ready:  # the first start has its own limit
            return late(managed) if managed.epoch > 1 else ""
        return first_of(
            problem(n, self._ledger.nodes[n.index], int(now_s * 1e9)) for n in managed.nodes
        ) or swollen(managed)


def stopped(managed: ManagedProcess, now_s: float) -> str:
    """Return a problem if its process has been stopped by a signal for too long."""
    since_s = now_s
    for sample in reversed(managed.samples):
        if not sample.stopped or managed.handle is None or sample.at_s < managed.handle.began_s:
            break
        since_s = sample.at_s
    seconds = now_s - since_s
    return f"has been stopped by a signal for {seconds:.1f} s" if seconds > FROZEN_S else ""


def late(managed: ManagedProcess) -> str:
    """Return a problem if opening takes longer than any of its nodes may."""
    if managed.handle is None or managed.handle.ready:
        return ""
    seconds = time.monotonic() - managed.handle.began_s
    allowed_s = max(node.start_s for node in managed.nodes)
    return f"not ready after {seconds:.1f} s" if seconds > allowed_s else ""


def swollen(managed: ManagedProcess) -> str:
    """Return a problem if it exceeds the sum of its nodes' memory limits, if all have one."""
    limits_mb = [node.memory_mb for node in managed.nodes]
    sample = managed.samples[-1] if managed.samples else None
    if (
        not all(limits_mb)
        or not sample
        or not managed.handle
        or sample.at_s < managed.handle.began_s
    ):
        return ""
    if sample.own_mb <= sum(limits_mb):
        return ""
    return f"takes {sample.own_mb:.0f} MB of its own, {sum(limits_mb):g} allowed"


def first_of(problems: Iterable[str]) -> str:
    """Return the first non-empty string, or an empty one."""
    return next(filter(None, problems), "")
