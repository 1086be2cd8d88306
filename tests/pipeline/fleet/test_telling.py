"""How often a host tells the others its half of the accounts."""

from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.fleet import hosted_graph
from pipeline.fleet.hosted_graph import IDLE_S, TELL_IDLE_S, TELL_S, HostedGraph


class Rounds:
    """An event that is never set, whose waits pass at once and are noted."""

    def __init__(self, changes_until_s: float, end_s: float) -> None:
        self.now_s, self.waits_s = 100.0, list[float]()
        self._quiet_s, self._end_s = self.now_s + changes_until_s, self.now_s + end_s

    def monotonic(self) -> float:
        return self.now_s

    def wait(self, timeout_s: float) -> bool:
        self.waits_s.append(timeout_s)
        self.now_s += timeout_s
        return self.now_s > self._end_s

    def tell(self, *, ready: bool, anyway: bool) -> bool:
        return anyway or self.now_s < self._quiet_s


def test_accounts_are_told_often_while_they_change_and_seldom_while_they_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rounds = Rounds(changes_until_s=1.0, end_s=1.0 + IDLE_S + 2.0)
    monkeypatch.setattr(hosted_graph, "time", rounds)
    hosted: Any = HostedGraph.__new__(HostedGraph)
    hosted.peers = {"other": rounds}
    supervisor: Any = SimpleNamespace(processes={})

    hosted._tell(supervisor, rounds)

    later = rounds.waits_s[rounds.waits_s.index(TELL_S) :]
    assert later == sorted(later)
    assert set(later) == {TELL_S, TELL_IDLE_S}
    assert later.count(TELL_S) * TELL_S == pytest.approx(1.0 + IDLE_S, abs=3 * TELL_IDLE_S)
