"""Measure what watching costs: `python -m bench.watching [GRAPH] [--rounds 3] [--json FILE]`.

Runs a graph of processes in real time without a viewer, saving, serving to nobody, to three
viewers, and to one that stands still. The order is another one in each round; ratios are to the
run without a viewer of the same round. The viewers are Rerun's own client without a window.
"""

import json
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click
import psutil
from rich.console import Console
from rich.table import Table

from bench.loop import spread
from bench.machine import facts
from bench.options import JSON, Bench, file_name, on_graph
from operators.visualise.server import free_ports, program
from pipeline.errors import RunError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.loaded_graph import account_of
from pipeline.run.supervisor import Supervisor

VIEWER = "visualise"  # the graph's node
STILL = "one that stands still"
CONDITIONS = {"off": 0, "saving": 0, "serving": 0, "three viewers": 3, STILL: 1}  # name -> viewers
JOIN_S = 20.0
RATIO = "_ratio"  # ends the name of a figure relative to `off`
Figures = dict[str, float]


@click.command(cls=Bench)
@on_graph
@click.option("--frames", default=300, show_default=True, type=click.IntRange(10))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=1, show_default=True, help="Of the order.")
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], frames: int, rounds: int,
    seed: int, path: Path | None,
) -> None:  # fmt: skip
    """Measure loop latency and processor time of a graph by how it is watched."""
    console, order = Console(), random.Random(seed)
    found: list[dict[str, Figures]] = []
    for number in range(rounds):
        done: dict[str, Figures] = {}
        for name in order.sample(list(CONDITIONS), len(CONDITIONS)):
            console.print(f"round {number + 1} of {rounds}: {name}")
            done[name] = measured(name, graph, source, changes, frames)
        found.append(done)
    summary = summarise(found)
    console.print(table(summary))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(
            {"bench": "watching", **facts(("rerun-sdk",)), "graph": file_name(graph),
             "frames": frames, "seed": seed, "n": rounds, "summary": summary, "rounds": found},
            indent=1,
        ))  # fmt: skip


def measured(
    name: str, graph: Path, source: Path | None, changes: tuple[str, ...], frames: int
) -> Figures:
    """Run the graph under one condition; return its figures."""
    port, web_port = free_ports(2)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as watching:
        values: dict[str, Any] = {"serve": True, "port": port, "web_port": web_port}
        if name == "saving":
            values = {"save": f"{folder}/seen.rrd"}
        wanted = () if name == "off" else (VIEWER,)
        laid = tuple((VIEWER, key, value) for key, value in values.items()) if wanted else ()
        plan = load(graph, Overlay(source, changes, "realtime", wanted, laid))
        with Supervisor(plan, frames=frames) as supervisor:
            supervisor.start()
            for number in range(CONDITIONS[name]):
                client = watching.enter_context(viewer(port, Path(folder) / f"{number}.rrd"))
                await_viewer(supervisor, client, port)
                if name == STILL:
                    client.send_signal(signal.SIGSTOP)
            before, began_s = cpu_s(supervisor), time.monotonic()
            last = before
            while not supervisor.finished:
                supervisor.tick()
                last = cpu_s(supervisor) or last
            took_s = time.monotonic() - began_s
            elapsed_s = supervisor.exposed_s
            supervisor.finish()
            supervisor.stop()
            if supervisor.failure:
                raise RunError(supervisor.failure)
            report = account_of(supervisor, elapsed_s)
    graph_s = sum(last[k] - before[k] for k in before if k in last and k != VIEWER)
    viewer_s = last.get(VIEWER, 0.0) - before.get(VIEWER, 0.0)
    latency_ms = report["loop"]["latency_ms"]
    return {
        "p50_ms": latency_ms["p50"], "p99_ms": latency_ms["p99"],
        "graph_cpu_percent": 100 * graph_s / took_s, "viewer_cpu_percent": 100 * viewer_s / took_s,
        "dropped": float(sum(
            sum(edge["dropped"].values()) for edge in report["edges"] if not edge.get("tap")
        )),
    }  # fmt: skip


@contextmanager
def viewer(port: int, out: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Run Rerun's own client, which writes what it is sent to a file, until the server ends."""
    own = str(free_ports(1)[0])
    client = subprocess.Popen(
        [program(), "--save", out, "--bind", "127.0.0.1", "--port", own,
         f"rerun+http://127.0.0.1:{port}/proxy"],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield client
    finally:
        client.kill()
        client.wait()


def connected(client: psutil.Process, port: int) -> bool:
    """Return whether a client has come to a server."""
    links = client.net_connections("tcp")
    return any(link.raddr and link.raddr.port == port for link in links)


def await_viewer(
    supervisor: Supervisor, client: "subprocess.Popen[bytes]", port: int
) -> None:  # fmt: skip
    """Supervise until a client is connected; raises `RunError` after `JOIN_S`."""
    process, late_s = psutil.Process(client.pid), time.monotonic() + JOIN_S
    while not connected(process, port):
        if time.monotonic() > late_s or client.poll() is not None:
            raise RunError(f"expected a viewer to connect within {JOIN_S:.0f} s, got none")
        supervisor.tick()


def cpu_s(supervisor: Supervisor) -> dict[str, float]:
    """Return the processor time of each process so far; empty while one of them ends.

    That of the viewer's node includes Rerun's server, which it starts.
    """
    found = {}
    try:
        for name in supervisor.plan.processes():
            process = psutil.Process(supervisor.pid(name))
            group = [process, *process.children(recursive=True)] if name == VIEWER else [process]
            times = [one.cpu_times() for one in group]
            found[name] = float(sum(t.user + t.system for t in times))
    except (psutil.Error, ValueError):
        return {}
    return found


def summarise(rounds: list[dict[str, Figures]]) -> dict[str, dict[str, Any]]:
    """Return by condition the median and range of each figure, and of its ratio to `off`.

    >>> one = summarise([{"off": {"p50_ms": 10.0}, "saving": {"p50_ms": 12.0}}])
    >>> one["saving"]["p50_ms_ratio"]["median"]
    1.2
    """
    found: dict[str, dict[str, Any]] = {}
    for name in rounds[0]:
        figures = {key: spread([one[name][key] for one in rounds]) for key in rounds[0][name]}
        for key in rounds[0][name]:
            if name != "off" and all(one["off"][key] for one in rounds):
                ratios = [one[name][key] / one["off"][key] for one in rounds]
                figures[f"{key}{RATIO}"] = spread(ratios)
        found[name] = figures
    return found


def table(summary: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return the figures, one a line: median, range, and the ratio to the run without a viewer."""
    shown = Table(title="what watching costs")
    for column in ("watched by", "figure", "median", "min .. max", "ratio", "min .. max"):
        shown.add_column(column)
    for name in (name for name in CONDITIONS if name in summary):
        figures = summary[name]
        for key in (key for key in figures if not key.endswith(RATIO)):
            ratio = figures.get(f"{key}{RATIO}")
            shown.add_row(name, key, *_cells(figures[key]), *(_cells(ratio) if ratio else ()))
    return shown


def _cells(value: Mapping[str, float]) -> tuple[str, str]:
    return f"{value['median']:.2f}", f"{value['min']:.2f} .. {value['max']:.2f}"


if __name__ == "__main__":
    main()
