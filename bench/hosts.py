"""Measure a graph over three hosts: `python -m bench.hosts [GRAPH] --seconds 30 [--json FILE]`.

Hosts are network namespaces of this machine with shared memory of their own, an agent on each, TLS
between them. It reports the latency of every hop and the error of the clocks, the bytes that each
host sends and those that the graph needs, and how soon the loss of a disconnected host is reported.
"""

import json
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, TextIO

import click
from rich.console import Console
from rich.table import Table

from bench.machine import facts
from bench.netns import Hosts, permitted
from bench.options import JSON, Bench, on_graph
from pipeline import codec
from pipeline.errors import RunError
from pipeline.fleet import secure
from pipeline.fleet.names import user_identity
from pipeline.fleet.provisioning import issue_for
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.graph.shipped import graph_path
from pipeline.messages import Message
from pipeline.run.inline import InlineRunner

DESK = "desk"  # the host that deploys
USER = "tester"
SAMPLES = 5  # exposures by which the size of messages is measured


class World(Hosts):
    """A graph's hosts with their agents, and a host to deploy from; use it as a context manager."""

    def __init__(self, folder: Path, graph: Path, **ahead_s: int) -> None:
        self.graph, self.plan, self.folder = graph, load(graph), folder
        super().__init__(folder, *self.plan.hosts, DESK, ahead_s=ahead_s)
        self.authority = folder / "authority"
        self.agents: dict[str, Any] = {}
        self._logs: list[TextIO] = []

    def __enter__(self) -> "World":
        secure.create(self.authority)
        addresses = {label: self.addresses[label] for label in self.plan.hosts}
        for _line in issue_for(self.authority, addresses, [self.plan], [USER]):
            pass
        super().__enter__()
        try:
            for label in self.plan.hosts:
                self.begin(label)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        for log in self._logs:
            log.close()

    def begin(self, label: str) -> None:
        """Start a host's agent, as at boot."""
        self._logs.append(self.log(label).open("a"))
        config = str(self.authority / f"host.{label}" / "agent.yaml")
        words = ("-m", "pipeline.cli", "agent", "--config", config)
        self.agents[label] = self.start(label, *words, log=self._logs[-1])

    def log(self, label: str) -> Path:
        """Return the log file of a host's agent."""
        return self.folder / f"{label}.log"

    def fovea(self, *words: str, timeout_s: float = 180) -> str:
        """Run a command on the deploying host; raises `RunError` with its output when it fails."""
        done = self.run(DESK, "-m", "pipeline.cli", *words, timeout_s=timeout_s)
        if done.returncode:
            raise RunError((done.stderr or done.stdout).strip())
        return done.stdout

    def up(self, *more: str) -> str:
        """Deploy the graph."""
        credentials = str(self.authority / user_identity(USER))
        return self.fovea("up", str(self.graph), "--credentials", credentials, *more)

    def states(self) -> dict[str, Any]:
        """Return the graph's state on every host, or why a host does not answer."""
        told = json.loads(self.fovea("ps", "--json"))
        found: dict[str, Any] = told[self.plan.name]["hosts"]
        return found

    def heard(self, label: str, words: str, since: int = 0, timeout_s: float = 60) -> float:
        """Wait for some words in a host's log; return how long that took. Raises `RunError`."""
        began_s = time.monotonic()
        while words not in " ".join(self.log(label).read_text()[since:].split()):
            if time.monotonic() - began_s > timeout_s:
                raise RunError(f"{label}: no {words!r} in its log within {timeout_s:.0f} s")
            time.sleep(0.02)
        return time.monotonic() - began_s


@click.command(cls=Bench)
@on_graph
@click.option("--seconds", default=30.0, show_default=True, type=click.FloatRange(1))
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], seconds: float, path: Path | None
) -> None:
    """Measure a graph over its hosts."""
    if not permitted():
        raise click.ClickException("network namespaces are not permitted here: run as root")
    if graph == graph_path("tracking"):  # the default of all benches: it has one host
        graph = graph_path("multi_host")
    more = [*(("--source", str(source)) if source else ()), *(f"--set={c}" for c in changes)]
    sizes = message_bytes(load(graph, Overlay(source, changes, "lockstep")))
    with tempfile.TemporaryDirectory() as folder, World(Path(folder), graph.resolve()) as world:
        world.up(*more)
        time.sleep(3.0)
        before, traffic = world.states(), {h: world.traffic(h) for h in world.plan.hosts}
        began_s = time.monotonic()
        time.sleep(seconds)
        spent = {h: world.traffic(h) for h in world.plan.hosts}
        lasted_s = time.monotonic() - began_s
        after = world.states()
        used = {h: (spent[h][1] - traffic[h][1]) / lasted_s for h in spent}
        figures = {
            "hops": hops(after),
            "hosts": {label: said[0]["hosts"] for label, said in after.items()},
            "sent_bytes_per_s": {h: round(b) for h, b in used.items()},
            "needed_bytes_per_s": needed(world.plan, sizes, before, after),
            "message_bytes": sizes,
            "lost_host": _pull(world),
        }
        world.fovea("down", world.plan.name)
    _show(figures)
    if path:
        path.write_text(json.dumps({"figures": figures, **facts()}, indent=1))


def message_bytes(plan: Plan) -> dict[str, int]:
    """Return the mean size of each output's messages, from some exposures in line."""
    seen: Counter[str] = Counter()
    count: Counter[str] = Counter()

    def watch(origin: str, message: Message) -> None:
        seen[origin] += len(codec.dumps(message))
        count[origin] += 1

    with InlineRunner(plan, watch=watch) as runner:
        for _seq in runner.run(SAMPLES):
            pass
    return {origin.removesuffix(".out"): seen[origin] // count[origin] for origin in seen}


def hops(states: dict[str, Any]) -> list[dict[str, Any]]:
    """Return for each edge the host that reads it, the hop's latency and the age of messages."""
    found = []
    for label, (state,) in states.items():
        nodes = {node["name"]: node for node in state["nodes"]}
        for edge in state["edges"]:
            node = nodes[edge["end"].partition(".")[0]]
            found.append(
                {
                    "edge": f"{edge['origin']} -> {edge['end']}", "host": label,
                    "hop_ms": node["hop_ms"], "age_ms": edge["age_ms"],
                    "clock_error_ms": edge["age_error_ms"], **edge["account"],
                }
            )  # fmt: skip
    return found


def needed(
    plan: Plan, sizes: dict[str, int], before: dict[str, Any], after: dict[str, Any]
) -> dict[str, int]:
    """Return the bytes per second that hosts must send: an output once to each reading host."""
    found: Counter[str] = Counter()
    rates: dict[tuple[str, str], float] = {}
    for label, (state,) in after.items():
        earlier = {edge["end"]: edge["sent"] for edge in before[label][0]["edges"]}
        seconds = (state["at_ns"] - before[label][0]["at_ns"]) / 1e9
        for edge in state["edges"]:
            if plan.node(edge["origin"].partition(".")[0]).host != label:
                key = (edge["origin"], label)
                rate = (edge["sent"] - earlier[edge["end"]]) / seconds
                rates[key] = max(rate, rates.get(key, 0.0))
    for (origin, _label), rate in rates.items():
        found[plan.node(origin.partition(".")[0]).host] += round(rate * sizes[origin])
    return dict(found)


def _pull(world: World) -> dict[str, float]:
    """Return how soon the first host reports the loss of the last one, and its return."""
    label, seer = world.plan.hosts[-1], world.plan.hosts[0]
    since = len(world.log(seer).read_text())
    world.link(label, up=False)
    missed_s = world.heard(seer, f"host {label} is lost", since)
    world.link(label, up=True)
    back_s = world.heard(seer, f"host {label} is back", since)
    return {"reported_after_s": round(missed_s, 2), "back_after_s": round(back_s, 2)}


def _show(figures: dict[str, Any]) -> None:
    console = Console()
    table = Table(title="hops")
    for column in ("edge", "read on", "hop p50 / p99 ms", "age p50 / p99 ms", "± ms", "dropped"):
        table.add_column(column)
    for hop in figures["hops"]:
        table.add_row(
            hop["edge"], hop["host"], f"{hop['hop_ms']['p50']:.2f} / {hop['hop_ms']['p99']:.2f}",
            f"{hop['age_ms']['p50']:.2f} / {hop['age_ms']['p99']:.2f}",
            f"{hop['clock_error_ms']:.2f}", str(hop["dropped"]),
        )  # fmt: skip
    console.print(table)
    for label, sent in figures["sent_bytes_per_s"].items():
        wanted = figures["needed_bytes_per_s"].get(label, 0)
        console.print(f"{label}: sends {sent / 1e6:.2f} MB/s, needed {wanted / 1e6:.2f} MB/s")
    console.print(figures["lost_host"])


if __name__ == "__main__":
    main()
