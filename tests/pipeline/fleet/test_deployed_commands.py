"""Commands on a graph over two hosts: the JSON of a local graph, logs, an order that half fails."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.client.deployed import DeployedGraph
from pipeline.client.find import find
from pipeline.errors import FoveaError, RunError
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.remembered import remembered
from tests.json_answers import ANSWERS, check
from tests.pipeline.fleet.agents import DUO, agents, fleet_of, handled, plan_of, state_of
from tests.sample_graphs import until

pytestmark = pytest.mark.hosts

SPARE = """\
  spare:
    operator: tests.samples:Count
    host: eye
    inputs: {frame: capture.roi}
"""
GRAPH = DUO.replace("  work:\n", f"{SPARE}  work:\n")
TALLY = """
nodes:
  tally:
    operator: tests.samples:Count
    host: brain
    inputs: {frame: work}
  near:
    operator: tests.samples:Count
    host: eye
    inputs: {frame: capture.roi}
"""
LABELS = ("eye", "brain")


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with agents(tmp_path, *LABELS), fleet_of(*LABELS) as fleet:
        up(fleet, plan_of(tmp_path, GRAPH))
        (tmp_path / "tally.yaml").write_text(TALLY)
        until(lambda: handled(fleet, "brain", "count", "duo") > 10)
        yield fleet
        if "duo" in remembered():
            down("duo", fleet.hosts)


def test_a_deployed_graph_answers_with_the_keys_of_a_local_one(
    fleet: Fleet, tmp_path: Path
) -> None:
    check(ANSWERS, GRAPH="duo", FILE=str(tmp_path / "tally.yaml"))

    assert "duo" not in remembered()


def test_a_log_on_another_host_is_followed(fleet: Fleet) -> None:
    lines: list[str] = []
    seen = threading.Event()

    def follow() -> None:
        # with the last lines: another instance that breaks writes the same ones, which are not new
        for line in find("duo").logs("work", 100, follow=True):
            lines.append(line)
            if "told to break" in line:
                seen.set()
                return

    reader = threading.Thread(target=follow, daemon=True)
    reader.start()

    def told() -> bool:  # until the reader has begun to follow
        with pytest.raises(RunError, match="told to break"):
            find("duo").command("work", "break_down", {})
        return seen.wait(10.0)  # seldom: an operator that dies 11 times in 60 s ends its graph

    until(told)

    reader.join(10)
    assert not reader.is_alive()
    assert "told to break" in lines[-1]


def test_a_change_that_the_second_host_refuses_is_undone_on_the_first(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change, asked = DeployedGraph._change, list[str]()

    def refuses(self: DeployedGraph, fleet: Fleet, label: str, *rest: object) -> object:
        asked.append(label)
        if len(asked) == 2:  # as if its plan had changed meanwhile
            *plans, revision = rest
            assert isinstance(revision, int)
            rest = (*plans, revision + 1)
        return change(self, fleet, label, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(DeployedGraph, "_change", refuses)
    before = {label: [n.name for n in state_of(fleet, label, "duo").nodes] for label in LABELS}

    with pytest.raises(FoveaError, match="it was changed meanwhile"):
        find("duo").add(tmp_path / "tally.yaml")

    first, second, taken_back = asked
    assert taken_back == first != second
    after = {label: [n.name for n in state_of(fleet, label, "duo").nodes] for label in LABELS}
    assert after == before
    assert set(remembered()["duo"].nodes) == {"capture", "spare", "work", "count"}
    for label, node in (("eye", "spare"), ("brain", "count")):
        seen = handled(fleet, label, node, "duo")
        until(lambda: handled(fleet, label, node, "duo") > seen + 5)  # noqa: B023
