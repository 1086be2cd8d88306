"""`fovea up --replace` on other hosts: no host on which a graph may still run is forgotten."""

from collections.abc import Mapping
from typing import Any

import pytest

from pipeline.errors import RunError, Silent
from pipeline.fleet import deploy
from pipeline.fleet.deploy import Fleet, up
from pipeline.fleet.hosts import Hosts
from pipeline.fleet.remembered import remember, remembered
from pipeline.graph.plan import Node, Plan
from pipeline.protocol import fleet as wire

BEFORE = Hosts({"a": "at a", "b": "at b"}, "", {"first": "a", "second": "b"})
AFTER = Hosts({"b": "at b", "c": "at c"})


class Agents(Fleet):
    """Agents without a transport. What hosts fail to do is given as label -> verb -> error."""

    def __init__(self, hosts: Hosts, failures: Mapping[str, Mapping[str, BaseException]]) -> None:
        self.hosts, self._failures = hosts, failures
        self.asked: list[tuple[str, str]] = []

    def __exit__(self, *_: object) -> None:
        pass

    def ask(self, label: str, verb: str, *_: Any) -> Any:
        self.asked.append((label, verb))
        if (error := self._failures.get(label, {}).get(verb)) is not None:
            raise error
        state = wire.State("g", label, 0, "running", "", (), (), (), (), {})
        return {
            "about": wire.About(label, wire.Versions.ours(), ()),
            "prepare": wire.Prepared({}),
            "state": wire.States((state,)),
        }.get(verb, wire.Accepted())


def plan_on(*labels: str) -> Plan:
    nodes = tuple(
        Node(index=i, name=f"on_{label}", operator="tests.samples:Ticker", settings={}, host=label)
        for i, label in enumerate(labels)
    )
    return Plan(name="g", clock="realtime", nodes=nodes, edges=(), hosts=labels)


def test_hosts_of_the_graph_before_are_known_after_the_new_one_failed_to_start() -> None:
    remember("g", BEFORE)
    fleet = Agents(AFTER, {"c": {"start": RunError("c: no")}})

    with pytest.raises(RunError, match="c: no"):
        up(fleet, plan_on("b", "c"), again=True)

    assert {label for label, verb in fleet.asked if verb == "down"} == {"b", "c"}
    assert remembered()["g"] == Hosts({"a": "at a"}, "", {"first": "a"})


def test_a_host_on_which_the_new_graph_could_not_be_stopped_is_known() -> None:
    remember("g", BEFORE)
    gone = {"start": RunError("c: no"), "down": Silent("c: silent")}

    with pytest.raises(RunError, match="c: no"):
        up(Agents(AFTER, {"c": gone}), plan_on("b", "c"), again=True)

    assert remembered()["g"] == Hosts({"a": "at a", "c": "at c"}, "", {"first": "a", "on_c": "c"})


def test_a_graph_that_failed_on_all_hosts_of_the_one_before_is_forgotten() -> None:
    remember("g", BEFORE)
    fleet = Agents(BEFORE, {"b": {"start": RunError("b: no")}})

    with pytest.raises(RunError, match="b: no"):
        up(fleet, plan_on("a", "b"), again=True)

    assert "g" not in remembered()


def test_all_hosts_are_known_while_the_new_graph_starts() -> None:
    remember("g", BEFORE)
    known = []

    class Watched(Agents):
        def ask(self, label: str, verb: str, *words: Any) -> Any:
            if verb == "start":
                known.append(remembered()["g"].points.keys())
            return super().ask(label, verb, *words)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(deploy, "Fleet", lambda hosts: Agents(hosts, {}))
        up(Watched(AFTER, {}), plan_on("b", "c"), again=True)

    assert known == [{"a", "b", "c"}] * 2
    assert remembered()["g"] == Hosts(AFTER.points, "", {"on_b": "b", "on_c": "c"})


def test_a_former_host_that_does_not_answer_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    remember("g", BEFORE)
    silent = {"a": {"about": Silent("a: no agent answers")}}
    monkeypatch.setattr(deploy, "Fleet", lambda hosts: Agents(hosts, silent))

    up(Agents(AFTER, {}), plan_on("b", "c"), again=True)

    assert remembered()["g"].points == {"a": "at a", **AFTER.points}
