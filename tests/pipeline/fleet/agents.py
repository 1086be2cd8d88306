"""Hosts for tests: agents in threads of this process, each with nodes of its own."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pipeline.fleet.agent import Agent
from pipeline.fleet.agent_file import AgentFile, HostConfig
from pipeline.fleet.deploy import Fleet
from pipeline.fleet.hosts import read_hosts
from pipeline.fleet.placement import ANY
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.protocol import fleet as wire
from pipeline.run.heartbeat import Heartbeat

SAMPLES = ("Ticker", "Pass", "PassEvery", "Pair", "Steer", "Count")
ALLOWED = {f"tests.samples:{name}": ANY for name in SAMPLES}
DUO = """
name: duo
hosts: [eye, brain]
nodes:
  capture:
    operator: tests.samples:Ticker
    host: eye
    settings: {rate_hz: 30}
  work:
    operator: tests.samples:Pass
    host: brain
    inputs: {frame: capture.context}
  count:
    operator: tests.samples:Count
    host: brain
    inputs: {frame: work}
"""
TRIO = """
name: trio
hosts: [sensor, compute, viewer]
nodes:
  capture:
    operator: tests.samples:Ticker
    host: sensor
    inputs: {schedule: steer}
    settings: {rate_hz: 30}
  work:
    operator: tests.samples:Pass
    host: compute
    inputs: {frame: capture.context}
  pair:
    operator: tests.samples:Pair
    host: compute
    inputs: {left: work, right: capture.roi}
  steer:
    operator: tests.samples:Steer
    host: compute
    inputs: {percept: pair}
  count:
    operator: tests.samples:Count
    host: viewer
    inputs: {frame: capture.context}
"""


def plan_of(folder: Path, text: str = TRIO) -> Plan:
    path = folder / "graph.yaml"
    path.write_text(text)
    return load(path)


def host_of(label: str, others: Sequence[str], folder: Path, **more: object) -> HostConfig:
    values = {"operators": ALLOWED, "state": str(folder / f"state-{label}"), **more}
    file = AgentFile(label=label, hosts=tuple(others), **values)  # type: ignore[arg-type]
    return HostConfig(file, folder)


class Running:
    """An agent that runs in a thread."""

    def __init__(self, own: HostConfig, heartbeat: Heartbeat | None = None) -> None:
        self.agent = Agent(own, heartbeat=heartbeat)
        self._thread = threading.Thread(target=self.agent.run)
        self._thread.start()

    def stop(self) -> None:
        self.agent.stop()
        self._thread.join()
        self.agent.__exit__()


@contextmanager
def agents(folder: Path, *labels: str) -> Iterator[dict[str, Running]]:
    running: dict[str, Running] = {}
    try:
        for label in labels:
            running[label] = Running(host_of(label, labels, folder))
        yield running
    finally:
        for one in running.values():
            one.stop()


def fleet_of(*labels: str) -> Fleet:
    return Fleet(read_hosts(labels, None))


def phases(fleet: Fleet, label: str, graph: str = "trio") -> list[str]:
    said = fleet.states(graph)[label]
    return [] if isinstance(said, str) else [state.phase for state in said]


def state_of(fleet: Fleet, label: str, graph: str = "trio") -> wire.State:
    (state,) = fleet.ask(label, "state", wire.Named(graph), wire.States).states
    return state


def handled(fleet: Fleet, label: str, node: str, graph: str = "trio") -> int:
    nodes = state_of(fleet, label, graph).nodes
    return next((n.handled for n in nodes if n.name == node), 0)
