"""Random faults in a graph: `python -m bench.chaos [GRAPH] --minutes 60 --seed 1 [--json FILE]`.

Runs a graph of processes in real time and injects faults chosen by a seed: it kills a process,
kills two at once, stops one for good or for a moment, and in a graph over several hosts also
disconnects a host. It reports for every fault the time until every victim has handled a frame
again, how much of that was loading (where known), and the longest gap in the sensor's commands; at
the end unbalanced accounts, orphaned processes and leftover files.
"""

import json
import os
import random
import signal
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.grounds import Ground, OneHost, ThreeHosts
from bench.machine import facts
from bench.netns import permitted
from bench.options import JSON, Bench, file_name, on_graph
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan

WARM_S = 3.0
SETTLE_S = (2.0, 12.0)  # between a recovery and the next fault
NAP_S = (0.1, 2.0)
CUT_S = (0.2, 6.0)  # without a network link
TIMEOUT_S = 60.0


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault and its effects."""

    kind: str
    victims: tuple[str, ...]
    at_s: float
    recovered_s: float  # from the fault (a nap: from its end) to the first frames of all victims
    load_s: float  # of it, for opening models and devices; of the slowest victim
    silence_s: float  # longest time without a new sensor command, from the fault on
    restarts: int


class Stuck(Exception):
    """The graph does not recover from a fault."""


class Chaos:
    """Injects faults into a running graph and waits for its recovery."""

    def __init__(self, ground: Ground, seed: int) -> None:
        self._ground, self._chance = ground, random.Random(seed)
        self._began_s = time.monotonic()

    def strike(self) -> Fault:
        """Inject a fault chosen by the seed; raises `Stuck` without recovery."""
        ground, chance = self._ground, self._chance
        kind = chance.choices([*ground.kinds], [*ground.kinds.values()])[0]
        whom = ground.hosts if kind == "partition" else ground.names
        victims = tuple(chance.sample(whom, 2 if kind == "volley" else 1))
        at_s, before = time.monotonic() - self._began_s, ground.restarts()
        watch = _Watch(ground, victims, fresh=kind in ("kill", "volley", "freeze"))
        if kind == "partition":
            ground.link(victims[0], up=False)
            watch.until(chance.uniform(*CUT_S))
            ground.link(victims[0], up=True)
        else:
            pids = [pid for name in victims if (pid := ground.pid(name))]
            _signal(pids, signal.SIGKILL if kind in ("kill", "volley") else signal.SIGSTOP)
            if kind == "nap":
                watch.until(chance.uniform(*NAP_S))
                _signal(pids, signal.SIGCONT)
        recovered_s = watch.recovered_s(f"{kind} of {', '.join(victims)}")
        loads = [ground.load_s(name) for name in victims] if watch.fresh else [0.0]
        return Fault(
            kind=kind,
            victims=victims,
            at_s=round(at_s, 3),
            recovered_s=round(recovered_s, 3),
            load_s=max(loads),
            silence_s=round(watch.silence_s, 3),
            restarts=ground.restarts() - before,
        )

    def pause(self) -> None:
        """Wait a random time between two faults, in which the spare process can start."""
        self._ground.run_for(self._chance.uniform(*SETTLE_S))


class _Watch:
    """Monitors the affected nodes' progress and the sensor's commands after a fault."""

    def __init__(self, ground: Ground, victims: Sequence[str], *, fresh: bool) -> None:
        self._ground, self.fresh = ground, fresh
        accounts = [a for name in victims for a in ground.accounts(name)]
        self._marks = [(a, a.epoch + fresh, a.handled) for a in accounts]
        self._commands, self._heard_s = ground.commands.total, time.monotonic()
        self.silence_s = 0.0

    def until(self, seconds: float) -> None:
        """Monitor for so many seconds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._look()
        self._marks = [(a, epoch, a.handled) for a, epoch, _ in self._marks]

    def recovered_s(self, what: str) -> float:
        """Return the time until all victims handle frames again; then wait for the next command.

        Raises `Stuck`.
        """
        began = time.monotonic()
        while not all(a.epoch >= epoch and a.handled > h + 1 for a, epoch, h in self._marks):
            if time.monotonic() - began > TIMEOUT_S or self._ground.failure:
                raise Stuck(f"{what}: {self._ground.failure or f'no frame for {TIMEOUT_S:.0f} s'}")
            self._look()
        back_s = time.monotonic() - began
        commands = self._ground.commands.total
        while self._ground.commands.total == commands:
            if time.monotonic() - began > back_s + TIMEOUT_S:
                raise Stuck(f"{what}: no commands for {TIMEOUT_S:.0f} s")
            self._look()
        return back_s

    def _look(self) -> None:
        self._ground.look()
        now_s, total = time.monotonic(), self._ground.commands.total
        self.silence_s = max(self.silence_s, now_s - self._heard_s)
        if total != self._commands:
            self._commands, self._heard_s = total, now_s


@click.command(cls=Bench)
@on_graph
@click.option("--minutes", default=60.0, show_default=True, type=click.FloatRange(0.1))
@click.option("--seed", default=1, show_default=True)
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], minutes: float, seed: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Inject faults into a running graph; its hosts are network namespaces."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    faults: list[Fault] = []
    with TemporaryDirectory() as folder, _ground(plan, graph, Path(folder)) as ground:
        ground.run_for(WARM_S)
        stuck = _strike_for(ground, minutes * 60, seed, faults)
        leftovers = ground.end()
    result = {
        "bench": "chaos", **facts(), "graph": file_name(graph), "minutes": minutes, "seed": seed,
        "recovery": {kind: summary([f for f in faults if f.kind == kind]) for kind in ground.kinds},
        "stuck": stuck, **leftovers, "faults": [asdict(f) for f in faults],
    }  # fmt: skip
    Console().print(_table(result))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))
    if stuck:
        raise click.ClickException(stuck)


def _ground(plan: Plan, graph: Path, folder: Path) -> OneHost | ThreeHosts:
    if not plan.hosts:
        return OneHost(plan)
    if not permitted():
        raise click.ClickException("network namespaces are not permitted here: run as root")
    return ThreeHosts(folder, graph.resolve())


def summary(faults: Sequence[Fault]) -> dict[str, float]:
    """Return statistics over all faults of a kind, in seconds; only the count without faults.

    >>> fault = Fault(kind="kill", victims=("a",), at_s=0, recovered_s=2, load_s=1.5,
    ...               silence_s=0.5, restarts=1)
    >>> summary([fault])["beyond_load_p50_s"]
    0.5
    """
    if not faults:
        return {"count": 0}
    recovered = np.array([f.recovered_s for f in faults])
    beyond = recovered - [f.load_s for f in faults]
    silence = np.array([f.silence_s for f in faults])
    return {
        "count": len(faults),
        "recovered_p50_s": float(np.percentile(recovered, 50)),
        "recovered_p99_s": float(np.percentile(recovered, 99)),
        "recovered_max_s": float(recovered.max()),
        "beyond_load_p50_s": float(np.percentile(beyond, 50)),
        "silence_p50_s": float(np.percentile(silence, 50)),
        "silence_max_s": float(silence.max()),
    }


def _strike_for(ground: Ground, seconds: float, seed: int, faults: list[Fault]) -> str:
    """Inject faults for so many seconds; return why that ended early, or an empty string."""
    chaos, began = Chaos(ground, seed), time.monotonic()
    with Progress() as progress:
        task = progress.add_task("faults", total=seconds)
        while (elapsed_s := time.monotonic() - began) < seconds:
            try:
                faults.append(chaos.strike())
            except Stuck as stuck:
                return str(stuck)
            chaos.pause()
            words = f"{len(faults)} faults, the last {faults[-1].recovered_s:.1f} s"
            progress.update(task, completed=elapsed_s, description=words)
    return ""


def _signal(pids: Sequence[int], number: signal.Signals) -> None:
    for pid in pids:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            continue


def _table(result: dict[str, Any]) -> Table:
    title = f"{len(result['faults'])} faults in {result['minutes']:g} min, seed {result['seed']}"
    table = Table(title=title)
    columns = ("fault", "count", "back p50 s", "p99 s", "max s", "beyond loading p50 s",
               "commands silent p50 s", "max s")  # fmt: skip
    for column in columns:
        table.add_column(column, justify="right")
    for kind, figures in result["recovery"].items():
        count, *rest_ = figures.values()
        table.add_row(kind, str(count), *(f"{value:.2f}" for value in rest_))
    told = {name: ", ".join(map(str, result[name])) or "none" for name in
            ("unbalanced", "orphans", "left")}  # fmt: skip
    table.caption = (
        f"accounts that do not add up: {told['unbalanced']}; orphans: {told['orphans']}; "
        f"files left: {told['left']}"
    )
    return table


if __name__ == "__main__":
    main()
