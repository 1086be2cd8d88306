"""A source that waits for its lost device is not stalled, for as long as it says and no longer."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.bus.ledger import NodeAccount, private_ledger
from pipeline.contract import Source
from pipeline.graph.plan import Node
from pipeline.messages import Message
from pipeline.node.health import busy_ns, problem
from pipeline.node.source import absence_ns
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import edge, go, plan_of, wait_for
from tests.samples import Ticker, TickerSettings

SECOND = 1_000_000_000
GRAPH = """\
nodes:
  ticker:
    operator: tests.pipeline.node.test_absence:Unplugged
    group: ends
    stall_s: 1.5
    settings: {rate_hz: 50, side_px: 16, lost_at: 5, away_s: 3.5, length: 12}
  count:
    operator: tests.samples:Count
    group: ends
    inputs: {frame: {from: ticker.roi, depth: 60}}
"""


@dataclass(frozen=True, kw_only=True)
class UnpluggedSettings(TickerSettings):
    """When the device is lost, how long it is away and whether the source says so."""

    lost_at: int = 0
    away_s: float = 1.0
    says: bool = True


class Unplugged(Ticker, Source[UnpluggedSettings, Mapping[str, Message]]):
    """A ticker whose device goes away once and comes back."""

    settings: UnpluggedSettings
    until_s = 0.0

    @property
    def absent_until_s(self) -> float:
        return self.until_s if self.settings.says else 0.0

    def produce(self) -> Mapping[str, Message] | None:
        if self.seq == self.settings.lost_at:
            self.until_s = time.monotonic() + self.settings.away_s
            time.sleep(self.settings.away_s)
            self.until_s = 0.0
        return super().produce()


def busy_account(since_s: float) -> NodeAccount:
    account = private_ledger(0, 1).nodes[0]
    account.busy_since_ns = round(since_s * SECOND)
    account.enter("busy")
    return account


def node() -> Node:
    return Node(index=0, name="capture", operator="a:B", settings={})


def test_waiting_for_a_device_is_no_stall_until_the_time_that_was_said() -> None:
    account = busy_account(since_s=100)
    account.absent_until_ns = absence_ns(160.0, 0, 101 * SECOND)

    told = {s: problem(node(), account, s * SECOND) for s in (109, 111, 159, 169, 171)}

    assert [s for s, why in told.items() if why] == [171]
    assert told[171] == "capture has worked on frame 0 for 11.0 s"


def test_a_device_that_is_back_leaves_the_time_of_a_stall_for_the_next_frame() -> None:
    account = busy_account(since_s=100)
    account.absent_until_ns = absence_ns(160.0, 0, 101 * SECOND)
    account.absent_until_ns = absence_ns(0.0, account.absent_until_ns, 130 * SECOND)

    assert account.absent_until_ns == 130 * SECOND
    assert problem(node(), account, 139 * SECOND) == ""
    assert "for 11.0 s" in problem(node(), account, 141 * SECOND)


def test_nothing_that_a_source_says_makes_it_wait_for_more_than_a_day() -> None:
    for said in (float("inf"), 1e300):
        assert absence_ns(said, 0, SECOND) == (86_400 + 1) * SECOND
    for said in (float("nan"), float("-inf"), -1.0, 0.0, 1.0):
        assert absence_ns(said, 0, SECOND) == 0


def test_work_after_an_absence_counts_from_its_own_beginning() -> None:
    account = busy_account(since_s=100)
    account.absent_until_ns = 50 * SECOND

    assert busy_ns(account, 103 * SECOND) == 3 * SECOND


def test_a_source_that_looks_for_its_device_longer_than_a_stall_goes_on(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, GRAPH)
    index = plan.node("ticker").index

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: supervisor.ledger.nodes[index].absent_until_ns)

    report = go(plan, 0, during)

    assert report["failure"] == ""
    assert report["summaries"]["count"]["seen"] == list(range(12))
    assert (edge(report, "count.frame")["lost_in_crash"], dict(report["restarts"])) == (0, {})


def test_one_that_does_not_say_so_is_replaced(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, GRAPH, changes=("ticker.says=false", "ticker.away_s=60"))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: supervisor.restarts)
        supervisor.finish()

    assert go(plan, 0, during)["restarts"]
