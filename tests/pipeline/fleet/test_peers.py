"""Clocks of other hosts, and the halves of accounts that hosts tell one another."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.bus.clocks import Reading
from pipeline.bus.ledger import private_ledger
from pipeline.fleet.peers import DRIFT, READ, WRITTEN, Offset, Peer, Replication, Sessions, adopt
from pipeline.fleet.placement import plan_for
from pipeline.protocol.codec import decode, encode
from pipeline.protocol.fleet import Accounts, Ping, Pong
from tests.pipeline.fleet.agents import TRIO, plan_of
from tests.sample_graphs import until


def test_an_offset_lies_within_its_error_whatever_the_delays() -> None:
    clock, ahead = Offset(), 1_000_000_000_000
    ways = [(5_000_000, 100_000), (200_000, 300_000), (90_000, 4_000_000), (150_000, 9_000_000)]
    now = 0
    for there, back in ways:
        came = now + there + ahead
        clock.add(now, came, came + 50_000, now + there + 50_000 + back)
        now += 200_000_000

    seen = clock.estimate(now)

    assert seen is not None
    assert abs(seen.offset_ns - ahead) <= seen.error_ns
    assert seen.error_ns <= 250_000 + DRIFT * 800_000_000
    later = clock.estimate(now + 60_000_000_000)
    assert later is not None
    assert later.error_ns > 5_000_000  # the last measurement is a minute old: clocks drift


def test_each_host_counts_its_half_and_receives_the_other(tmp_path: Path) -> None:
    sensor, viewer = (plan_for(plan_of(tmp_path), name) for name in ("sensor", "viewer"))
    edge = next(e.index for e in sensor.edges if e.end == "count.frame")
    ledgers = [private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2)]
    here, there = (
        Replication(sensor, ledgers[0], "viewer"),
        Replication(viewer, ledgers[1], "sensor"),
    )
    ledgers[0].edges[edge].sent = 9
    ledgers[1].edges[edge].delivered, ledgers[1].edges[edge].seen = 7, 8
    ledgers[1].edges[edge].reader_epoch = 1

    for one, other in ((here, there), (there, here)):
        told = one.tell(ready=True, anyway=False)
        assert told is not None
        other.hear(told)
        assert one.tell(ready=True, anyway=False) is None

    assert (ledgers[0].edges[edge].seen, ledgers[0].edges[edge].in_flight) == (8, 2)
    assert ledgers[1].edges[edge].sent == 9
    here.lost()
    assert not ledgers[0].edges[edge].live  # a writer waits for no reader that is gone


def test_a_restarted_host_continues_from_the_accounts_of_the_others(tmp_path: Path) -> None:
    sensor, viewer = (plan_for(plan_of(tmp_path), name) for name in ("sensor", "viewer"))
    old, fresh = (private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2))
    edge = next(e.index for e in sensor.edges if e.end == "count.frame")
    old.edges[edge].sent, old.edges[edge].seen, old.edges[edge].delivered = 20, 19, 18

    adopt(sensor, fresh, [Replication(viewer, old, "sensor").whole()])

    assert fresh.edges[edge].sent == 20
    siblings = sensor.readers("capture", "context")
    assert {fresh.edges[e.index].sent for e in siblings} == {20}


def test_a_local_edge_beside_one_between_hosts_begins_at_zero(tmp_path: Path) -> None:
    text = TRIO + "  near:\n    operator: tests.samples:Count\n    host: sensor\n"
    text += "    inputs: {frame: capture.context}\n"
    sensor, viewer = (plan_for(plan_of(tmp_path, text), name) for name in ("sensor", "viewer"))
    old, fresh = (private_ledger(len(sensor.edges), len(sensor.nodes)) for _ in range(2))
    far, near = (
        next(e.index for e in sensor.edges if e.end == end) for end in ("count.frame", "near.frame")
    )
    old.edges[far].sent = old.edges[far].seen = old.edges[far].delivered = 20

    adopt(sensor, fresh, [Replication(viewer, old, "sensor").whole()])

    assert (fresh.edges[near].sent, fresh.edges[near].lost_in_crash) == (0, 0)
    assert fresh.edges[near].base == 20


def test_counts_of_edges_that_are_not_of_the_sending_host_are_ignored(tmp_path: Path) -> None:
    plan = plan_for(plan_of(tmp_path), "sensor")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    everything = {e.index: (99,) * len(WRITTEN) for e in plan.edges}
    halves = {e.index: (99,) * len(READ) for e in plan.edges}

    Replication(plan, ledger, "viewer").hear(Accounts(1, "", True, everything, halves))

    for edge in plan.edges:
        account = ledger.edges[edge.index]
        assert account.sent == 0  # it writes nothing here
        assert account.seen == (99 if edge.end == "count.frame" else 0)


def test_counts_of_another_graph_of_that_name_are_ignored(tmp_path: Path) -> None:
    plan = plan_for(plan_of(tmp_path), "sensor")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    theirs = Replication(plan_for(plan_of(tmp_path), "viewer"), ledger, "sensor", fingerprint="old")
    mine = private_ledger(len(plan.edges), len(plan.nodes))
    edge = next(e.index for e in plan.edges if e.end == "count.frame")
    ledger.edges[edge].reader_epoch = 7

    told = theirs.tell(ready=True, anyway=True)
    assert told is not None
    Replication(plan, mine, "viewer", fingerprint="new").hear(told)
    assert mine.edges[edge].reader_epoch == 0

    Replication(plan, mine, "viewer", fingerprint="old").hear(told)
    assert mine.edges[edge].reader_epoch == 7


def test_a_clock_that_was_reset_is_followed_at_once() -> None:
    clock = Offset()
    for k in range(64):
        now = k * 200_000_000
        clock.add(now, now + 10**12, now + 10**12, now + 100_000)

    now = 64 * 200_000_000
    clock.add(now, 5_000_000, 5_000_000, now + 5_000_000)

    seen = clock.estimate(now + 5_000_000)
    assert seen is not None
    assert abs(seen.offset_ns - (2_500_000 - now)) <= seen.error_ns


class SilentSession:
    """A session whose questions nobody answers, or one that tells the time."""

    def __init__(self, *, answers: bool) -> None:
        self.answers, self.closed = answers, False

    def sender(self, key: str, *, urgent: bool) -> "SilentSession":
        return self

    def matching(self) -> bool:
        return False

    def ask(self, key: str, question: bytes, timeout_s: float) -> bytes | None:
        sent_ns = decode(Ping, question).sent_ns
        return encode(Pong(sent_ns, sent_ns, sent_ns)) if self.answers else None

    def close(self) -> None:
        self.closed = True


def test_a_link_that_stays_away_is_opened_anew_until_one_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("PING_S", 0.005), ("LOST_S", 0.02), ("REOPEN_S", (0.02, 0.04))):
        monkeypatch.setattr(f"pipeline.fleet.peers.{name}", value)
    plan = plan_for(plan_of(tmp_path), "sensor")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    opened: list[SilentSession] = []

    def another(points: tuple[str, ...]) -> Any:
        opened.append(SilentSession(answers=len(opened) == 3))
        return opened[-1]

    replication, sessions = Replication(plan, ledger, "viewer"), Sessions(another, ["there"])
    peer = Peer("trio", "sensor", replication, Reading(), sessions, "there")
    peer.begin()
    try:
        until(lambda: len(opened) == 4 and not peer.lost)
    finally:
        peer.close()

    assert peer.broken == ""
    assert peer.losses == 1
    assert [session.closed for session in opened] == [True] * 4


def test_a_session_is_closed_once_no_host_needs_it_and_hosts_of_a_router_share_it() -> None:
    opened: dict[SilentSession, tuple[str, ...]] = {}

    def another(points: tuple[str, ...]) -> Any:
        session = SilentSession(answers=True)
        opened[session] = points
        return session

    sessions = Sessions(another, ["router", "alone", "router"])
    left, right, alone = sessions.join("router"), sessions.join("router"), sessions.join("alone")
    newer = sessions.renew("router", left)
    sessions.leave(left)

    assert left is right is alone
    assert sessions.renew("router", right) is newer
    sessions.leave(right)
    assert not any(session.closed for session in opened)  # the first one is for the host alone, too
    sessions.leave(sessions.renew("alone", alone))
    sessions.leave(alone)
    assert list(opened.values()) == [("alone", "router"), ("router",), ("alone",)]
    assert [session.closed for session in opened] == [True, False, True]
    sessions.leave(newer)
    sessions.leave(newer)
    assert all(session.closed for session in opened)


def test_sessions_that_no_host_has_begun_to_use_are_closed_in_the_end() -> None:
    opened: list[SilentSession] = []

    def another(points: tuple[str, ...]) -> Any:
        opened.append(SilentSession(answers=True))
        return opened[-1]

    sessions = Sessions(another, ["there"])
    sessions.close()
    sessions.close()

    assert [session.closed for session in opened] == [True]
