"""Measure swaps: `python -m bench.swap [GRAPH] --count 1000 [--json FILE]`.

Runs a graph of processes in real time and repeatedly swaps its nodes, each for the same operator in
a new process, while a tap receives the sensor commands. Prints frames lost and doubled on lossless
edges, drops on the others, how long a node paused, the longest time between two sensor commands
(with swaps and without), and the memory growth of the other processes.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil
from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.leftovers import run_for
from bench.machine import facts
from bench.options import JSON, Bench, file_name, on_graph
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import private_ledger
from pipeline.bus.outport import Arrival
from pipeline.bus.pool import PoolReader
from pipeline.bus.session import Session
from pipeline.contract import outputs_of
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan, load_operator
from pipeline.node.wiring import key_of
from pipeline.protocol.codec import fields_of
from pipeline.protocol.orders import Refused, Result, SwapOrder
from pipeline.run.report import compose
from pipeline.run.rundir import folder_of, memory_of, running
from pipeline.run.supervisor import Supervisor

TIMEOUT_S = 60.0
MEMORY_EVERY = 50  # swaps


class Commands:
    """Number and time of each sensor command that a tap receives."""

    def __init__(self, plan: Plan) -> None:
        edge = next(e for e in plan.edges if e.command)
        folder = folder_of(plan.name)
        message = outputs_of(load_operator(plan.node(edge.source).operator))[edge.output]
        pool = PoolReader(memory_of(running()[plan.name]), f"{edge.source}.{edge.output}")
        port = InPort(message, private_ledger(1, 0).edges[0], pool, 1, self._note, tap=True)
        self.seqs: list[int] = []
        self.times_s: list[float] = []
        self._session = Session(folder, "bench-swap")
        key = key_of(plan.name, edge.source, edge.output)
        self._stop: Callable[[], None] = self._session.listen(key, port.receive)

    def _note(self, arrival: Arrival) -> None:
        if arrival.message is not None:
            self.times_s.append(time.monotonic())
            self.seqs.append(arrival.header.seq)

    def close(self) -> None:
        """Stop listening."""
        self._stop()
        self._session.close()

    def gaps_ms(self, first: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the times between successive commands, from the one numbered `first` on."""
        return np.diff(np.array(self.times_s[first:])) * 1000


@click.command(cls=Bench)
@on_graph
@click.option("--node", "nodes", multiple=True, default=("saliency", "policy"), show_default=True)
@click.option("--count", default=20, show_default=True, type=click.IntRange(1), help="Per node.")
@click.option("--probation", default=5, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option(
    "--warm-s",
    default=10.0,
    show_default=True,
    type=click.FloatRange(1),
    help="Without a swap: the baseline. The procedural scene fills its cache for five minutes.",
)
@click.option(
    "--pause-s", default=0.0, show_default=True, type=click.FloatRange(0), help="After each swap."
)
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], nodes: tuple[str, ...], count: int,
    probation: int, warm_s: float, pause_s: float, path: Path | None,
) -> None:  # fmt: skip
    """Swap nodes of a running graph repeatedly."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    swaps: list[dict[str, Any]] = []
    with Supervisor(plan) as supervisor:
        supervisor.start()
        commands = Commands(plan)
        run_for(supervisor, warm_s)
        memory, quiet = [_memory(supervisor)], len(commands.seqs)
        dropped = _dropped(supervisor)
        began_s, first = time.monotonic(), _exposed(supervisor)
        for turn in track(range(count * len(nodes)), "swapping"):
            node = nodes[turn % len(nodes)]
            swaps.append(_swap(supervisor, SwapOrder(node=node, probation=probation)))
            run_for(supervisor, pause_s)
            if not (turn + 1) % MEMORY_EVERY:
                memory.append(_memory(supervisor))
        fps = (_exposed(supervisor) - first) / (time.monotonic() - began_s)
        run_for(supervisor, 2.0)
        all_dropped = _dropped(supervisor)
        memory.append(_memory(supervisor))
        commands.close()
        supervisor.finish()
        supervisor.stop()
        report = compose(
            supervisor.plan, supervisor.ledger, {}, {}, duration_s=1.0,
            restarts=supervisor.restarts,
        )  # fmt: skip
    done = [s for s in swaps if not s["refused"]]
    others = [p for p in memory[0] if p not in {plan.node(n).process for n in nodes}]
    result = {
        "bench": "swap", **facts(), "graph": file_name(graph), "nodes": nodes, "count": count,
        "probation_frames": probation, **_losses(report["edges"], commands.seqs),
        "gap_ms": {n: _spread([s["gap_ms"] for s in done if s["node"] == n]) for n in nodes},
        "fps": fps, "pause_s": pause_s,
        "dropped_on_latest": {"without_swaps": dropped, "while_swapping": all_dropped - dropped},
        "left_out": {
            n: _counted([_left_out(s) for s in done if s["node"] == n])
            for n in nodes
        },
        "command_gap_ms": {
            "without_swaps": _spread(commands.gaps_ms()[: quiet - 1]),
            "while_swapping": _spread(commands.gaps_ms(quiet)),
        },
        "refused": [s["refused"] for s in swaps if s["refused"]],
        "memory_every": MEMORY_EVERY,
        "others": {p: {k: [m[p][k] for m in memory] for k in memory[0][p]} for p in others},
        "restarts": report["restarts"], "edges": report["edges"], "swaps": swaps,
    }  # fmt: skip
    Console().print(*_tables(result))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))


def _swap(supervisor: Supervisor, order: SwapOrder) -> dict[str, Any]:
    answers: list[Result] = []
    supervisor.control.take(order, answers.append)
    began_s = time.monotonic()
    while not answers:
        if time.monotonic() - began_s > TIMEOUT_S or supervisor.failure:
            raise click.ClickException(f"{order.node} was not swapped: {supervisor.failure}")
        supervisor.tick()
    refused = answers[0].reason if isinstance(answers[0], Refused) else ""
    done = {} if refused else fields_of(answers[0])
    return {"node": order.node, **done, "refused": refused, "took_s": time.monotonic() - began_s}


def _exposed(supervisor: Supervisor) -> int:
    """Return the number of frames that the source has sent."""
    return max(edge.sent for edge in supervisor.ledger.edges)


def _dropped(supervisor: Supervisor) -> int:
    """Return the number of messages dropped or lost on edges that keep the latest."""
    found = 0
    for edge in supervisor.plan.edges:
        if edge.keep == "latest":
            told = supervisor.ledger.edges[edge.index].report()
            found += sum(told["dropped"].values()) + told["lost_in_crash"]
    return found


def _left_out(swap: dict[str, Any]) -> int:
    """Return the most messages left out on one input; a swap with a stop reports none."""
    return max(swap.get("left_out", {}).values(), default=0)


def _counted(values: list[int]) -> dict[str, int]:
    """Return how many swaps left out each number of messages on one input."""
    return {str(value): values.count(value) for value in sorted(set(values))}


def _memory(supervisor: Supervisor) -> dict[str, dict[str, float]]:
    """Return resident and locked megabytes and open files by process."""
    found = {}
    for process in supervisor.plan.processes():
        pid = supervisor.pid(process)
        status = Path(f"/proc/{pid}/status").read_text()
        locked_kb = next(int(li.split()[1]) for li in status.splitlines() if "VmLck" in li)
        seen = psutil.Process(pid)
        found[process] = {
            "rss_mb": seen.memory_info().rss / 1e6,
            "locked_mb": locked_kb / 1e3,
            "open_files": seen.num_fds(),
        }
    return found


def _losses(edges: list[dict[str, Any]], seqs: list[int]) -> dict[str, int]:
    """Return losses over the whole run; a reader refuses a doubled message as unmatched."""
    lossless = [e for e in edges if e["keep"] == "every"]
    return {
        "frames": max(e["offered"] for e in edges),
        "lost": sum(e["offered"] - e["delivered"] for e in lossless),
        "doubled_commands": len(seqs) - len(set(seqs)),
    }


def _spread(values: Any) -> dict[str, float]:
    known = np.array(values, np.float64)
    if not len(known):
        return {"p50": 0.0, "p99": 0.0, "max": 0.0}
    return {
        "p50": float(np.percentile(known, 50)),
        "p99": float(np.percentile(known, 99)),
        "max": float(known.max()),
    }


def _tables(result: dict[str, Any]) -> tuple[Table, Table]:
    times = Table(title=f"{result['count']} swaps of each of {', '.join(result['nodes'])}")
    for column in ("", "p50 ms", "p99 ms", "longest ms"):
        times.add_column(column, justify="right")
    rows = {f"{node} paused": spread for node, spread in result["gap_ms"].items()}
    rows |= {f"commands, {k}": spread for k, spread in result["command_gap_ms"].items()}
    for name, spread in rows.items():
        times.add_row(name, *(f"{spread[k]:.1f}" for k in ("p50", "p99", "max")))
    times.caption = (
        f"{len(result['refused'])} refused; {result['frames']} frames; "
        f"lossless edges: {result['lost']} lost; "
        f"{result['doubled_commands']} commands doubled; {result['dropped_on_latest']} dropped "
        f"on edges that keep the latest; left out between the old instance's last output and the "
        f"new one's first, on one input (messages: swaps) {result['left_out']}; "
        f"{result['fps']:.1f} fps; restarts {sum(result['restarts'].values())}"
    )
    memory = Table(title="the others, before -> after")
    for column in ("process", "RSS MB", "locked MB", "open files"):
        memory.add_column(column, justify="right")
    for process, seen in result["others"].items():
        pairs = [f"{v[0]:.0f} -> {v[-1]:.0f}" for v in seen.values()]
        memory.add_row(process, *pairs)
    return times, memory


if __name__ == "__main__":
    main()
