"""Figures between two looks at a running graph: rates, processor time, the loop and its budget."""

import msgspec

from pipeline.client.graph_client import Status
from pipeline.protocol.fleet import EdgeState, Process, State
from pipeline.run.verdict import BUDGET_FRAMES


class Loop(msgspec.Struct, kw_only=True, frozen=True):
    """From a picture's readiness to its command, beside the time there is; milliseconds."""

    latency_ms: dict[str, float]  # p50, p99
    budget_ms: dict[str, float]  # one and two frames at the present rate; empty without frames


class LiveFigures(msgspec.Struct, kw_only=True, frozen=True):
    """What happened in a second, by `name_of`."""

    edge_hz: dict[str, float]  # by the edge's `node.input`
    cpu_percent: dict[str, float]  # by process, of one core
    loop: Loop | None  # None: nothing commands the sensor


def live_figures(before: Status, now: Status, seconds: float) -> LiveFigures:
    """Return the figures; what was not there before, or began anew, has none."""
    sent = {key: edge.sent for key, edge in edges_of(before).items()}
    rates = {
        key: max(0, edge.sent - sent[key]) / seconds
        for key, edge in edges_of(now).items() if key in sent
    }  # fmt: skip
    known = processes_of(before)
    cpu = {
        key: 100 * (process.cpu_s - known[key].cpu_s) / seconds
        for key, process in processes_of(now).items()
        if key in known and known[key].pid == process.pid and process.pid
    }
    loop = _loop(now, max(rates.values(), default=0.0))
    return LiveFigures(edge_hz=rates, cpu_percent=cpu, loop=loop)


def name_of(host: str, name: str) -> str:
    """Return `host/name`; on the only host the name.

    >>> name_of("", "policy.tracks"), name_of("desk", "policy.tracks")
    ('policy.tracks', 'desk/policy.tracks')
    """
    return f"{host}/{name}" if host else name


def edges_of(status: Status) -> dict[str, EdgeState]:
    """Return the edges by the name of their end."""
    return {
        name_of(host, edge.end): edge for host, state in _states(status) for edge in state.edges
    }


def processes_of(status: Status) -> dict[str, Process]:
    """Return the processes by their names."""
    return {name_of(host, p.name): p for host, state in _states(status) for p in state.processes}


def _loop(status: Status, frames_hz: float) -> Loop | None:
    found = [
        node.loop_ms for _, state in _states(status) for node in state.nodes
        if node.loop_ms.get("p50")
    ]  # fmt: skip
    if not found:
        return None
    slowest = max(found, key=lambda times: times["p50"])
    budget = {name: 1000 * n / frames_hz for name, n in BUDGET_FRAMES.items() if frames_hz}
    return Loop(latency_ms={name: slowest[name] for name in BUDGET_FRAMES}, budget_ms=budget)


def _states(status: Status) -> list[tuple[str, State]]:
    return [
        (host, state) for host, said in status.hosts.items() if not isinstance(said, str)
        for state in said
    ]  # fmt: skip
