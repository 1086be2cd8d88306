"""The status of a local graph lists its processes with their restarts and crashes."""

import signal
from functools import partial
from pathlib import Path

from rich.console import Console

from pipeline.cli.tables import process_table
from pipeline.client.find import find
from pipeline.protocol.fleet import Process
from pipeline.protocol.orders import SwapOrder
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    CHAIN,
    beside,
    go,
    handled,
    plan_of,
    send_signal,
    swapped,
    wait_for,
)


def processes(graph: str) -> dict[str, Process]:
    (said,) = find(graph).status().hosts.values()
    assert not isinstance(said, str)
    return {process.name: process for state in said for process in state.processes}


def test_the_status_has_restarts_and_crashes_of_every_process(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, CHAIN.replace("  count:\n", "  count:\n    restart: never\n"))
    found: dict[str, Process] = {}

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: min(handled(supervisor, n) for n in ("count", "glance")) > 3)
        for node in ("count", "glance"):
            send_signal(supervisor, node, signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.restarts.get("glance") and supervisor.pid("glance"))
        wait_for(supervisor, lambda: supervisor.crashes.get("count"))
        found.update(processes(plan.name))
        assert found["glance"].pid == supervisor.pid("glance")
        supervisor.finish()

    go(plan, 0, during)

    counts = {name: (one.restarts, one.crashes) for name, one in found.items()}
    assert counts == {"ticker": (0, 0), "glance": (1, 1), "count": (0, 1)}
    assert found["count"].pid == 0  # it is gone; its number may be that of another process by now
    assert found["count"].nodes == ("count",)


def states(graph: str) -> tuple[str, dict[str, str]]:
    """Return the phase of a graph, and what `ps` says of each of its processes."""
    status = find(graph).status()
    (said,) = status.hosts.values()
    assert not isinstance(said, str)
    with (console := Console(width=200)).capture() as caught:
        console.print(process_table([status]))
    rows = [line.split() for line in caught.get().splitlines() if line.startswith(graph)]
    return said[0].phase, {name: word for _, name, word, *_ in rows}


def test_a_node_that_is_away_for_good_does_not_make_the_others_starting(tmp_path: Path) -> None:
    text = CHAIN.replace("  count:\n", "  count:\n    restart: never\n")
    text = text.replace("  glance:\n", "  glance:\n    restart: {backoff_s: 60}\n")
    plan = plan_of(tmp_path, text)
    seen: list[tuple[str, dict[str, str]]] = []

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: min(handled(supervisor, n) for n in ("count", "glance")) > 3)
        for node in ("count", "glance"):
            send_signal(supervisor, node, signal.SIGKILL)
            wait_for(supervisor, partial(supervisor.crashes.get, node))
            seen.append(states(plan.name))
        supervisor.finish()

    go(plan, 0, during)

    assert seen == [
        ("running", {"ticker": "running", "glance": "running", "count": "gone"}),
        ("starting", {"ticker": "running", "glance": "gone", "count": "gone"}),
    ]


def providers(graph: str) -> dict[str, str]:
    (said,) = find(graph).status().hosts.values()
    assert not isinstance(said, str)
    return {node.name: node.provider for state in said for node in state.nodes}


def test_the_status_has_what_computes_the_network_of_every_node(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, CHAIN.replace("samples:Pass", "samples:Computed"))
    found: dict[str, str] = {}

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: providers(plan.name)["glance"])
        found.update(providers(plan.name))
        other = SwapOrder(node="glance", changes={"on": "cpu"}, probation=1)
        swapped(beside(supervisor, lambda: find(plan.name).swap(other)))
        wait_for(supervisor, lambda: providers(plan.name)["glance"] == "cpu")
        supervisor.finish()

    report = go(plan, 0, during)

    assert found == {"ticker": "", "count": "", "glance": "tensorrt, cpu"}
    on = {stage["node"]: stage.get("provider") for stage in report["stages"]}
    assert on == {"ticker": None, "count": None, "glance": "cpu"}
