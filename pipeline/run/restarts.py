"""Restart processes after a pause, or end the run."""

import logging

from pipeline.errors import RunError
from pipeline.graph.plan import Restart
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import ending
from pipeline.run.process_manager import ProcessManager

HEALTHY_S = 1.0  # a process that ran this long starts with the shortest back-off again
LONGEST_BACKOFF_S = 5.0
UNABLE_S = 2.0  # pause after a failed start
log = logging.getLogger(__name__)


class Restarts:
    """The restarts of one run, by the rules of its nodes."""

    def __init__(self, manager: ProcessManager) -> None:
        self._manager = manager
        self.at_least = 0  # minimum allowed, whatever the graph sets

    def begin_again(self, managed: ManagedProcess, now_s: float) -> None:
        """Restart a process whose pause is over."""
        managed.next_start_s = 0.0
        try:
            self._manager.begin(managed)
        except RunError as error:  # e.g. no memory: the others continue, and it is retried
            log.error("%s", error)
            managed.next_start_s = now_s + UNABLE_S
        self._manager.note()

    def on_end(self, managed: ManagedProcess, status: int, now_s: float) -> None:
        """Handle the end of a process, after all its events were read."""
        announced = managed.handle is not None and managed.handle.left
        unborn = self._manager.is_unborn(managed)
        self._manager.vacate(managed)
        how = ending(status) + ("" if announced or status else ", which it did not announce")
        last, managed.last_words = managed.last_words, ""
        self._count(managed, now_s)
        succeeded = announced and status == 0
        if not succeeded:
            self.count_crash(managed.name)
        if self._manager.failure:
            return
        to_read = self._manager.run_folder.to_read(managed.name)
        why = self._follow(managed, how, now_s, succeeded=succeeded, unborn=unborn)
        log.warning(
            "%s ended by %s, see %s%s", managed.name, how, to_read, self._next(managed, now_s)
        )
        self._manager.note()
        if why:
            self._manager.failure = f"{managed.name} {why}" + (f": {last}" if last else "")

    def count_crash(self, process: str) -> None:
        """Count an unexpected end of a process."""
        counts = self._manager.crashes
        counts[process] = counts.get(process, 0) + 1

    def _follow(
        self, managed: ManagedProcess, how: str, now_s: float, *, succeeded: bool, unborn: bool
    ) -> str:
        """Schedule a restart or none; return the reason when the run has to end.

        Sources begin only when every process has been ready, so they would wait for a missing one.
        """
        manager, rule = self._manager, managed.nodes[0].restart
        if manager.plan.clock == "lockstep":
            return f"ended by {how}: a lockstep run cannot go on"
        if rule.policy == "never" or (rule.policy == "on-failure" and succeeded):
            if unborn or manager.sources_wait:
                return f"ended by {how} before the graph ran, and may not start again"
            before = manager.finished
            manager.finished_sources |= managed.sources
            last = manager.finished and not (before or succeeded or manager.ending)
            return f"ended by {how}: no source is left" if last else ""
        recent = _recent(managed, now_s)
        if recent > self._most(managed):
            return f"died {recent} times within {rule.window_s:.0f} s"
        managed.next_start_s = now_s + _pause_s(rule, managed.quick_deaths)
        manager.restarts[managed.name] = manager.restarts.get(managed.name, 0) + 1
        return ""

    def _next(self, managed: ManagedProcess, now_s: float) -> str:
        """Return when it starts again, as the end of a sentence; empty if it does not."""
        if not managed.next_start_s:
            return ""
        pause_s, window_s = managed.next_start_s - now_s, managed.nodes[0].restart.window_s
        times = f"{_recent(managed, now_s)} of {self._most(managed)} times in {window_s:g} s"
        return f"; starts again in {pause_s:.2g} s ({times})"

    def _most(self, managed: ManagedProcess) -> int:
        return max(managed.nodes[0].restart.most, self.at_least)

    def _count(self, managed: ManagedProcess, now_s: float) -> None:
        managed.deaths.append(now_s)
        lived = managed.going_since_s and now_s - managed.going_since_s > HEALTHY_S
        managed.quick_deaths = 0 if lived else managed.quick_deaths + 1
        managed.going_since_s = 0.0


def _recent(managed: ManagedProcess, now_s: float) -> int:
    """Return how often a process ended within the window of its rule."""
    window_s = managed.nodes[0].restart.window_s
    return sum(1 for death in managed.deaths if now_s - death < window_s)


def _pause_s(rule: Restart, quick_deaths: int) -> float:
    """Return the pause before the next start in seconds, which doubles each time.

    >>> _pause_s(Restart(), 0), _pause_s(Restart(), 3), _pause_s(Restart(), 50)
    (0.05, 0.4, 5.0)
    """
    return min(LONGEST_BACKOFF_S, rule.backoff_s * (1 << min(quick_deaths, 8)))
