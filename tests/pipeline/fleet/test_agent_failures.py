"""Agents through failures: exceptions, damaged state, a bad link, hosts that are not there."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.bus.network import LOCAL
from pipeline.errors import RunError
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.hosts import read_hosts
from pipeline.protocol import fleet as wire
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from tests.pipeline.fleet.agents import (
    Running,
    agents,
    fleet_of,
    handled,
    host_of,
    phases,
    plan_of,
    state_of,
)
from tests.pipeline.run.bad_link import BadLink
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


def test_an_exception_while_a_question_is_answered_ends_no_agent(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OverflowError("by whatever was overlooked")

    plan = plan_of(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.fleet.admission.permitted", broken)
        with pytest.raises(RunError, match="prepare failed: Overflow"):
            up(fleet, plan)

    up(fleet, plan)
    down("trio", fleet.hosts)


def test_the_start_of_a_part_that_worked_once_is_retried(
    three: dict[str, Running], fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    up(fleet, plan_of(tmp_path))
    three["sensor"].stop()
    failures = []

    def begin(*words: Any, **more: Any) -> Supervisor:
        if not failures:
            failures.append("the camera is not there yet")
            raise RunError(failures[0])
        return Supervisor(*words, **more)

    monkeypatch.setattr("pipeline.fleet.hosted_graph.Supervisor", begin)
    three["sensor"] = Running(host_of("sensor", LABELS, tmp_path))

    until(lambda: phases(fleet, "sensor") == ["running"])
    assert failures
    down("trio", fleet.hosts)


def test_a_damaged_state_stops_one_graph_and_not_the_host(tmp_path: Path) -> None:
    own = host_of("sensor", LABELS, tmp_path)
    own.state.mkdir(parents=True, exist_ok=True)
    for name, text in {"a": "[]", "b": "", "c": '{"plan": 3}'}.items():
        (own.state / f"{name}.graph").write_text(text)
    try:
        with agents(tmp_path, *LABELS), fleet_of(*LABELS) as fleet:
            up(fleet, plan_of(tmp_path))
            down("trio", fleet.hosts)
    finally:
        for name in "abc":
            (own.state / f"{name}.graph").unlink()


def test_a_host_behind_a_bad_link_is_missed_and_found_again(
    three: dict[str, Running], tmp_path: Path
) -> None:
    near = base() / f"bad-{os.getpid()}.sock"
    far = Path(three["viewer"].agent.host.endpoint.removeprefix(LOCAL))
    hosts = read_hosts(("sensor", "compute", f"viewer={LOCAL}{near}"), None)

    def lost() -> bool:
        return {b.label: b.lost for b in state_of(fleet, "sensor").hosts}["viewer"]

    def goes_on(label: str, node: str) -> None:
        before = handled(fleet, label, node)
        until(lambda: handled(fleet, label, node) > before + 10)

    with BadLink(near, far) as link, Fleet(hosts) as fleet:
        up(fleet, plan_of(tmp_path))
        link.delay_s, link.loss = 0.03, 0.1
        goes_on("viewer", "count")
        assert not lost()
        link.delay_s, link.loss = 0.0, 0.0

        for worse, better in ((link.stalled.set, link.stalled.clear), (link.cut, link.mend)):
            worse()
            until(lost)
            goes_on("compute", "steer")  # no other host waits for it
            better()
            until(lambda: not lost())
            goes_on("viewer", "count")
        down("trio", hosts)
    near.unlink(missing_ok=True)


def test_a_host_without_an_agent_is_named(tmp_path: Path) -> None:
    with (
        Fleet(read_hosts(("nowhere",), None)) as fleet,
        pytest.raises(RunError, match="nowhere: no agent answers at unixsock"),
    ):
        fleet.ask("nowhere", "about", wire.Nothing(), wire.About, 0.3)
