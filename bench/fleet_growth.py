"""How a deployment grows with its hosts: `python -m bench.fleet_growth 1 10 50 [--json FILE]`.

One agent a host, all on this machine, over TLS with credentials of their own: each runs one small
source, whose pictures the first host reads. Measured directly and through a router: the seconds of
`up`, `ps`, `health` and `down` as whole commands, the time until the clocks are known, and, while
the graph runs, packets and bytes on the loopback device, processor time and memory. A round whose
graph did not come up is counted as failed. The hosts share the cores, and whatever else uses the
loopback device meanwhile is counted too.
"""

import json
import os
import re
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click
import psutil

from bench.loop import spread
from bench.machine import facts
from bench.options import JSON, ROOT, Bench
from bench.results.markdown import table_of
from pipeline.errors import RunError
from pipeline.fleet import secure
from pipeline.fleet.names import ROUTED, user_identity
from pipeline.fleet.provisioning import issue_for
from pipeline.graph.loader import load

USER = "tester"
PATIENCE_S = 120.0
LOOPBACK = "lo"
Row = dict[str, Any]


@click.command(cls=Bench, help=__doc__)
@click.argument("hosts", nargs=-1, type=click.IntRange(1, 64))
@click.option("--way", "ways", multiple=True, type=click.Choice(["direct", "router"]))
@click.option("--rate", default=2.0, show_default=True, help="Pictures per second of a source.")
@click.option("--seconds", default=10.0, show_default=True, type=click.FloatRange(1))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@JSON
def main(
    hosts: tuple[int, ...], ways: tuple[str, ...], rate: float, seconds: float, rounds: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Measure each number of hosts by each way."""
    rows = []
    for count in hosts or (1, 10, 50):
        for way in ways or ("direct", "router"):
            found, failures = [], []
            for number in range(rounds):
                click.echo(f"{count} hosts, {way}: round {number + 1} of {rounds}", err=True)
                try:
                    found.append(measured(count, way == "router", rate=rate, seconds=seconds))
                except RunError as error:
                    failures.append(str(error))
                    click.echo(failures[-1], err=True)
            figures = summary(found) if found else {}
            rows.append({"hosts": count, "way": way, "failed": len(failures), **figures})
            result = {
                "bench": "fleet_growth", **facts(("eclipse-zenoh", "cryptography")),
                "rate_hz": rate, "seconds": seconds, "n": rounds, "rows": rows,
            }  # fmt: skip
            if path:
                path.write_text(json.dumps(result, indent=1) + "\n")
    click.echo(table_of(rows))


def summary(rounds: list[Row]) -> Row:
    """Return the median of each figure, and for what took time its range too.

    >>> summary([{"up_s": 2.0, "packets_per_s": 9}, {"up_s": 4.0, "packets_per_s": 11}])
    {'up_s': 3.0, 'up_s_range': '2.0 to 4.0', 'packets_per_s': 10.0}
    """
    found: Row = {}
    for name in rounds[0]:
        seen = spread([one[name] for one in rounds])
        found[name] = round(float(seen["median"]), 2)
        if name.endswith("_s") and not name.endswith("_per_s"):
            found[f"{name}_range"] = f"{seen['min']} to {seen['max']}"
    return found


def graph_text(name: str, hosts: int, rate: float) -> str:
    """Return a graph in which every host exposes and the first one reads.

    >>> print(graph_text("star", 1, 2.0).strip())
    name: star
    hosts: [h0]
    nodes:
      s0: {operator: "bench.samples:Metronome", host: h0, settings: {rate_hz: 2.0, side_px: 8}}
      r0: {operator: "bench.samples:Sink", host: h0, group: read, inputs: {frame: s0}}
    """
    labels = [f"h{i}" for i in range(hosts)]
    lines = [f"name: {name}", f"hosts: [{', '.join(labels)}]", "nodes:"]
    for i, label in enumerate(labels):
        settings = f"{{rate_hz: {rate}, side_px: 8}}"
        lines += [
            f'  s{i}: {{operator: "bench.samples:Metronome", host: {label}, settings: {settings}}}',
            f'  r{i}: {{operator: "bench.samples:Sink", host: h0, group: read, '
            f"inputs: {{frame: s{i}}}}}",
        ]
    return "\n".join(lines) + "\n"


class Agents:
    """Agents of a graph's hosts, and a router if they are behind one; use `running`."""

    def __init__(self, folder: Path, hosts: int, routed: bool, rate: float) -> None:
        self.folder, self.name = folder, f"grow-{secrets.token_hex(3)}"
        self.graph = folder / "graph.yaml"
        self.graph.write_text(graph_text(self.name, hosts, rate))
        self.labels = [f"h{i}" for i in range(hosts)]
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = int(probe.getsockname()[1])
        self.routed = routed
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for place in ("home", "tmp"):
            (folder / place).mkdir()
        self.environment = os.environ | {
            "HOME": str(folder / "home"), "TMPDIR": str(folder / "tmp"), "PYTHONPATH": str(ROOT),
        }  # fmt: skip

    def provision(self) -> None:
        """Make all credentials and files."""
        authority = self.folder / "authority"
        secure.create(authority)
        addresses = {
            label: f"{ROUTED}127.0.0.1:{self._port}"
            if self.routed
            else f"127.0.1.{i + 1}:{self._port}"
            for i, label in enumerate(self.labels)
        }
        for _line in issue_for(authority, addresses, [load(self.graph)], [USER]):
            pass

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the router and every agent; end them afterwards."""
        try:
            if self.routed:
                self._start("router", "router", "--config", "authority/router/router.yaml")
            for label in self.labels:
                self._start(label, "agent", "--config", f"authority/host.{label}/agent.yaml")
            for name in self.processes:
                self._await_word(name)
            yield
        finally:
            for process in self.processes.values():
                process.terminate()
            for process in self.processes.values():
                try:
                    process.wait(30)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()

    def fovea(self, *words: str) -> tuple[float, str]:
        """Run a command; return its seconds and output. Raises `RunError` when it fails."""
        began_s = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "pipeline.entry", *words], cwd=self.folder,
            env=self.environment, capture_output=True, text=True, timeout=600, check=False,
        )  # fmt: skip
        took_s = time.monotonic() - began_s
        if done.returncode:
            raise RunError(f"fovea {words[0]}: {(done.stderr or done.stdout).strip()}")
        return took_s, done.stdout

    def states(self) -> dict[str, Any]:
        """Return the graph's state on every host; raises `RunError` for a host without one."""
        hosts = json.loads(self.fovea("ps", "--json")[1])[self.name]["hosts"]
        for label, said in hosts.items():
            if isinstance(said, str) or not said:
                raise RunError(f"{label}: {said or 'does not run the graph'}")
        return {label: said[0] for label, said in hosts.items()}

    def cpu_s(self) -> float:
        """Return the processor time of all processes so far."""
        return float(sum(sum(p.cpu_times()[:2]) for p in self._family()))

    def memory_mb(self, name: str) -> float:
        """Return the proportional memory of an agent, or of the router, and its children."""
        own = psutil.Process(self.processes[name].pid)
        found = [one.memory_full_info().pss for one in (own, *own.children(recursive=True))]
        return float(sum(found)) / 1e6

    def _family(self) -> list[psutil.Process]:
        own = [psutil.Process(process.pid) for process in self.processes.values()]
        return [one for each in own for one in (each, *each.children(recursive=True))]

    def _start(self, name: str, *words: str) -> None:
        with (self.folder / f"{name}.log").open("wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", "pipeline.entry", *words], cwd=self.folder,
                env=self.environment, stdout=log, stderr=log,
            )  # fmt: skip

    def _await_word(self, name: str) -> None:
        log, late_s = self.folder / f"{name}.log", time.monotonic() + PATIENCE_S
        while not re.search("listens at|is reached through", log.read_text()):
            if time.monotonic() > late_s or self.processes[name].poll() is not None:
                raise RunError(f"{name}: did not start: {log.read_text()[-500:]}")
            time.sleep(0.1)


def measured(hosts: int, routed: bool, *, rate: float, seconds: float) -> Row:
    """Deploy to that many hosts, and return what it took."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="grow")))
        agents = Agents(folder, hosts, routed, rate)
        agents.provision()
        stack.enter_context(agents.running())
        credentials = f"authority/{user_identity(USER)}"
        up_s, _ = agents.fovea("up", "graph.yaml", "--credentials", credentials)
        clocks_s = until(lambda: clocks_known(agents))
        found = {"up_s": round(up_s, 2), "clocks_known_after_s": round(clocks_s, 2)}
        found |= steady(agents, seconds)
        for command in ("ps", "health"):
            found[f"{command}_s"] = round(agents.fovea(command, "--json")[0], 2)
        found["down_s"] = round(agents.fovea("down", agents.name)[0], 2)
        return found


def steady(agents: Agents, seconds: float) -> Row:
    """Return traffic, processor time, memory and clocks while the graph runs undisturbed."""
    time.sleep(2.0)
    before, spent_s, began_s = traffic(), agents.cpu_s(), time.monotonic()
    time.sleep(seconds)
    after, lasted_s = traffic(), time.monotonic() - began_s
    cpu_s = agents.cpu_s() - spent_s
    states = agents.states()
    links = [link for state in states.values() for link in state["hosts"]]
    others = [agents.memory_mb(label) for label in agents.labels[1:]]
    return {
        "links": len(links),
        "lost": sum(link["losses"] for link in links),
        "dropped": sum(
            sum(edge["account"]["dropped"].values())
            for state in states.values() for edge in state["edges"]
        ),
        "packets_per_s": round((after[0] - before[0]) / lasted_s),
        "kilobytes_per_s": round((after[1] - before[1]) / lasted_s / 1e3, 1),
        "cpu_percent": round(100 * cpu_s / lasted_s, 1),
        "first_host_mb": round(agents.memory_mb("h0"), 1),
        "other_host_mb": round(sum(others) / len(others), 1) if others else 0.0,
        "router_mb": round(agents.memory_mb("router"), 1) if agents.routed else 0.0,
        "clock_error_most_ms": round(max((x["clock_error_ms"] for x in links), default=0.0), 2),
        "round_trip_most_ms": round(max((x["round_trip_ms"] for x in links), default=0.0), 2),
    }  # fmt: skip


def traffic() -> tuple[int, int]:
    """Return the packets and bytes that the loopback device has carried."""
    seen = psutil.net_io_counters(pernic=True)[LOOPBACK]
    return seen.packets_sent, seen.bytes_sent


def clocks_known(agents: Agents) -> bool:
    """Whether every host answers, and knows the clock of every partner."""
    try:
        states = agents.states()
    except RunError:
        return False
    return all(link["clock_error_ms"] > 0 for state in states.values() for link in state["hosts"])


def until(holds: Callable[[], bool]) -> float:
    """Wait until something holds; return how long that took. Raises `RunError` when it is late."""
    began_s = time.monotonic()
    while not holds():
        if time.monotonic() - began_s > PATIENCE_S:
            raise RunError(f"the clocks of some hosts are not known after {PATIENCE_S:.0f} s")
        time.sleep(0.1)
    return time.monotonic() - began_s


if __name__ == "__main__":
    main()
