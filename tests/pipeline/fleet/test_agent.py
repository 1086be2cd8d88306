"""Agents on one machine, over unix sockets: a graph is deployed to them and supervised."""

import hashlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.client.find import find
from pipeline.errors import FoveaError, RunError
from pipeline.fleet import hosted_graph
from pipeline.fleet.deploy import Fleet, attach, down, send_weights, up
from pipeline.fleet.links import asker_permits
from pipeline.fleet.names import agent_key, host_identity
from pipeline.fleet.questions import Questions
from pipeline.fleet.remembered import remembered
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode_answer, encode
from pipeline.protocol.orders import SwapOrder
from pipeline.run.heartbeat import EVERY_S, Heartbeat
from pipeline.run.rundir import base
from tests.pipeline.fleet.agents import (
    DUO,
    TRIO,
    Running,
    agents,
    fleet_of,
    handled,
    host_of,
    phases,
    plan_of,
    state_of,
)
from tests.sample_graphs import until

pytestmark = pytest.mark.hosts

LABELS = ("sensor", "compute", "viewer")


@pytest.fixture
def three(tmp_path: Path) -> Iterator[dict[str, Running]]:
    with agents(tmp_path, *LABELS) as running:
        yield running


@pytest.fixture
def fleet(three: dict[str, Running]) -> Iterator[Fleet]:
    with fleet_of(*LABELS) as fleet:
        yield fleet


def test_a_graph_goes_up_runs_over_its_hosts_and_comes_down(fleet: Fleet, tmp_path: Path) -> None:
    up(fleet, plan_of(tmp_path))

    until(
        lambda: handled(fleet, "viewer", "count") > 30 and handled(fleet, "compute", "steer") > 30
    )
    assert {p.name for p in state_of(fleet, "compute").processes} == {"work", "pair", "steer"}
    assert "trio" in remembered()
    with pytest.raises(RunError, match="runs already; take it down first"):
        up(fleet, plan_of(tmp_path))

    assert down("trio", fleet.hosts) == []

    assert fleet.states() == {label: [] for label in LABELS}
    assert "trio" not in remembered()
    left = [p for label in LABELS for p in (base() / f"trio@{label}").glob("*.sock")]
    assert left == []


@pytest.mark.parametrize(
    ("node", "changes", "said"),
    [
        ("steer", {"operator": "tests.samples:Nosy"}, r"compute: steer\.operator: .* allow list"),
        ("capture", {"settings": {"rate_hz": "often"}}, r"sensor: capture\.rate_hz: input should"),
        (
            "count",
            {"settings": {"hold": "/etc/shadow"}},
            r"viewer: count\.hold: .* allow list",
        ),
    ],
)
def test_a_graph_that_one_host_refuses_starts_on_none(
    fleet: Fleet, node: str, changes: dict[str, Any], said: str, tmp_path: Path
) -> None:
    plan = plan_of(tmp_path)
    nodes = tuple(replace(n, **changes) if n.name == node else n for n in plan.nodes)

    with pytest.raises(FoveaError, match=said):
        up(fleet, replace(plan, nodes=nodes))

    assert fleet.states() == {label: [] for label in LABELS}


def test_another_version_is_refused_before_anything_starts(fleet: Fleet, tmp_path: Path) -> None:
    old = wire.Versions("0.0.1", "1.0", 1)
    question = wire.Prepare(plan_of(tmp_path), old, {})

    with pytest.raises(RunError, match=r"expected fovea 0\.0\.1, Zenoh 1\.0, envelope 1, got"):
        fleet.ask("sensor", "prepare", question, wire.Prepared)


@pytest.mark.parametrize("data", [b"", b"{", b"[1,2]", b'{"graph": 3}', b"\xff" * 100, b"{}" * 9])
def test_noise_is_refused_and_the_agent_lives(fleet: Fleet, data: bytes) -> None:
    for verb in ("prepare", "start", "down", "state", "log", "weights", "recall", "nothing"):
        with pytest.raises(FoveaError):
            fleet.ask("sensor", verb, data, wire.Prepared)

    assert fleet.ask("sensor", "about", wire.Nothing(), wire.About).label == "sensor"


def test_a_host_without_permission_is_refused_and_blocks_nothing(
    fleet: Fleet, tmp_path: Path
) -> None:
    way = Network(
        connect=(fleet.hosts.points["sensor"],),
        permits=asker_permits(host_identity("viewer"), {"sensor": fleet.hosts.points["sensor"]}),
    )
    session = Session.across(way)
    key = partial(agent_key, "sensor", host_identity("viewer"))
    try:
        assert session.ask(key("weights"), b"x", 0.5) is None  # they share no graph yet
        up(fleet, plan_of(tmp_path))
        for verb in ("weights", "start", "nothing"):
            said = session.ask(key(verb), b"x", 5)
            assert said is not None
            with pytest.raises(RunError, match=f"host.viewer may not {verb} here"):
                decode_answer(wire.Prepared, said, "sensor")
    finally:
        session.close()

    down("trio", fleet.hosts)


def test_a_deployed_graph_takes_commands_and_orders_from_a_client(
    fleet: Fleet, tmp_path: Path
) -> None:
    up(fleet, plan_of(tmp_path))

    trio = find("trio")
    assert trio.configure("work", {"hold": 2}).settings["hold"] == 2
    assert "no path from outside" in refusal(partial(trio.configure, "work", {"hold": "../x"}))
    assert "no node wrok, did you mean 'work'" in refusal(partial(trio.configure, "wrok", {}))
    until(lambda: trio.command("work", "recall", {}).answer["held"])
    assert set(trio.schema("count").inputs) == {"frame"}

    done = trio.swap(SwapOrder(node="work", operator="tests.samples:PassEvery", probation=5))
    assert done.proven_frames >= 5
    for wrong, said in (
        (SwapOrder(node="work", operator="tests.samples:Nosy"), "not on the allow list"),
        (SwapOrder(node="work", changes={"hold": "~/x"}), "no path from outside"),
    ):
        assert said in refusal(partial(trio.swap, wrong))
    part = find("trio@compute")
    assert "no node count" in refusal(partial(part.swap, SwapOrder(node="count")))
    assert "that changes nothing" in refusal(partial(trio.replan, lambda plan: plan))
    before = handled(fleet, "compute", "steer")
    until(lambda: handled(fleet, "compute", "steer") > before + 10)
    assert part.health().keys() == {"work", "pair", "steer"}
    down("trio", fleet.hosts)


def refusal(act: Callable[[], Any]) -> str:
    with pytest.raises(FoveaError) as caught:
        act()
    return str(caught.value)


def test_a_node_that_is_killed_starts_again_on_its_host(fleet: Fleet, tmp_path: Path) -> None:
    up(fleet, plan_of(tmp_path))

    def work() -> wire.Process:
        return next(p for p in state_of(fleet, "compute").processes if p.name == "work")

    os.kill(work().pid, signal.SIGKILL)

    until(lambda: work().restarts == 1)
    before = handled(fleet, "compute", "work")
    until(lambda: handled(fleet, "compute", "work") > before + 10)
    down("trio", fleet.hosts)


def test_a_host_that_ends_is_reported_and_runs_its_part_again_when_it_is_back(
    three: dict[str, Running], fleet: Fleet, tmp_path: Path
) -> None:
    up(fleet, plan_of(tmp_path))
    until(lambda: handled(fleet, "viewer", "count") > 10)

    three["viewer"].stop()
    seen = lambda: {b.label: b.lost for b in state_of(fleet, "sensor").hosts}  # noqa: E731
    until(lambda: seen()["viewer"])
    assert "no agent answers" in fleet.states()["viewer"]
    three["viewer"] = Running(host_of("viewer", LABELS, tmp_path))

    until(lambda: not seen()["viewer"])
    until(lambda: isinstance(fleet.states("trio")["viewer"], list))
    until(lambda: phases(fleet, "viewer") == ["running"])
    until(lambda: handled(fleet, "viewer", "count") > 10)
    down("trio", fleet.hosts)


def test_another_graph_of_the_name_takes_the_place_of_the_first_when_asked_to(
    fleet: Fleet, tmp_path: Path
) -> None:
    up(fleet, plan_of(tmp_path))
    until(lambda: handled(fleet, "viewer", "count") > 10)

    fewer = "\n".join(TRIO.split("\n")[: TRIO.split("\n").index("  count:")]) + "\n"
    fewer = fewer.replace("[sensor, compute, viewer]", "[sensor, compute]")
    up(fleet, plan_of(tmp_path, fewer.replace("rate_hz: 30", "rate_hz: 20")), again=True)

    until(lambda: handled(fleet, "compute", "steer") > 10)
    assert fleet.states()["viewer"] == []  # the first graph ran there, this one does not
    edge = next(e for e in state_of(fleet, "compute").edges if e.end == "work.frame")
    assert edge.account["offered"] < 200  # its own, not those of the graph before
    down("trio", fleet.hosts)


def test_two_graphs_share_a_host_and_both_go_on_after_it_began_again(
    three: dict[str, Running], fleet: Fleet, tmp_path: Path
) -> None:
    for name in ("zoo", "ant"):
        up(fleet, plan_of(tmp_path, TRIO.replace("name: trio", f"name: {name}")))

    three["compute"].stop()
    three["compute"] = Running(host_of("compute", LABELS, tmp_path))

    for name in ("zoo", "ant"):
        until(lambda name=name: phases(fleet, "compute", name))  # type: ignore[misc]
        before = handled(fleet, "compute", "steer", name)
        until(lambda n=name, b=before: handled(fleet, "compute", "steer", n) > b + 5)  # type: ignore[misc]
        down(name, fleet.hosts)


def test_an_interrupted_up_leaves_nothing_running(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.fleet.deploy._await", interrupted)
    with pytest.raises(KeyboardInterrupt):
        up(fleet, plan_of(tmp_path))

    assert fleet.states() == {label: [] for label in LABELS}
    assert remembered() == {}


def test_a_graph_that_was_deployed_from_elsewhere_is_found(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    up(fleet, plan_of(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path / "elsewhere"))
    assert remembered() == {}

    assert attach("trio", fleet) == sorted(LABELS)

    assert remembered()["trio"].nodes["count"] == "viewer"
    assert down("trio", remembered()["trio"]) == []
    with pytest.raises(RunError, match="trio: does not run on"):
        attach("trio", fleet)


def test_weights_that_a_host_allows_and_has_not_are_sent(tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(b"a network")
    digest = hashlib.sha256(b"a network").hexdigest()
    own = host_of("sensor", LABELS, tmp_path, weights={digest: ""})
    running = Running(own)
    try:
        with fleet_of("sensor") as fleet:
            lacks = wire.Lacks((digest, "0" * 64))
            assert fleet.ask("sensor", "lacks", lacks, wire.Missing).digests == (digest,)
            send_weights(fleet, "sensor", (digest,), {digest: file})
            assert fleet.ask("sensor", "lacks", lacks, wire.Missing).digests == ()
            with pytest.raises(FoveaError, match="not on the allow list"):
                fleet.ask("sensor", "weights", b"another", wire.Accepted)
    finally:
        running.stop()
        (own.state / "weights" / digest).unlink()


def test_the_next_file_may_be_sent_as_soon_as_the_reply_to_the_last_one_is_there() -> None:
    questions = Questions()
    said: list[bytes] = []

    def send_another(reply: bytes) -> None:
        said.append(reply)
        if len(said) == 1:
            questions.put("user.me", "a/weights", b"second", said.append)

    questions.put("user.me", "a/weights", b"first", send_another)
    for _ in range(2):
        assert questions.answer_next(lambda question: wire.Nothing(), slow=True)

    assert said == [encode(wire.Nothing())] * 2


def test_the_heartbeat_of_an_agent_tells_whether_its_graphs_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "heartbeat"
    plan = plan_of(tmp_path, DUO.replace("[eye, brain]", "[eye]").replace("brain", "eye"))
    with Heartbeat(file) as heartbeat:
        own = Running(host_of("eye", (), tmp_path), heartbeat)
        try:
            until(lambda: file.exists())
            assert file.read_text() == "running\n"  # there is nothing that does not
            with fleet_of("eye") as fleet:
                up(fleet, plan)
                until(lambda: file.read_text() == "running\n")

                monkeypatch.setattr(hosted_graph, "HANGS_S", -1.0)  # as if nobody ticked
                time.sleep(0.5)  # what was begun is written
                last = file.stat().st_mtime_ns
                time.sleep(1.5 * EVERY_S)
                assert file.stat().st_mtime_ns == last
                monkeypatch.undo()
                until(lambda: file.stat().st_mtime_ns > last)
        finally:
            own.stop()
