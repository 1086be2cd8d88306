"""An hour of bad luck: `python -m bench.chaos [GRAPH] --minutes 60 --seed 1 [--json FILE]`.

Runs a graph of processes in real time and does harm to one process after another, chosen by a seed:
kills it, kills two at once, stops it for good, stops it for a moment. For every fault: the time
until every victim has handled a frame again, how much of it was loading, and the longest silence in
the sensor's commands. At the end: accounts, orphans, and what was left behind.
"""

import json
import os
import random
import signal
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.aftermath import Traces, rest, unbalanced
from bench.machine import facts
from bench.options import JSON, Bench, on_graph
from pipeline.graph import load
from pipeline.overlay import Overlay
from pipeline.plan import sources
from pipeline.report import compose
from pipeline.supervisor import Supervisor

KINDS = {"kill": 0.4, "volley": 0.1, "freeze": 0.25, "nap": 0.25}  # shares of all faults
WARM_S = 3.0
SETTLE_S = (2.0, 12.0)  # between a recovery and the next fault
NAP_S = (0.1, 2.0)
PATIENCE_S = 60.0


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault and what it cost."""

    kind: str
    victims: tuple[str, ...]
    at_s: float
    recovered_s: float  # from the blow (a nap: from its end) to the first frames of all victims
    load_s: float  # of it, opening models and devices; the slowest victim's
    silence_s: float  # longest time without a new sensor command, from the blow on
    restarts: int


class Chaos:
    """Does harm to a running graph and waits for it to get over it."""

    def __init__(self, supervisor: Supervisor, seed: int) -> None:
        self._supervisor, self._chance = supervisor, random.Random(seed)
        source = next(sources(supervisor.plan))
        self._loop = supervisor.ledger.nodes[source.index].histograms["loop"]

    def strike(self) -> Fault:
        """One fault, chosen by the seed; raises `ClickException` when nobody recovers."""
        chance = self._chance
        kind = chance.choices([*KINDS], [*KINDS.values()])[0]
        names = [*self._supervisor.plan.processes()]
        victims = tuple(chance.sample(names, 2 if kind == "volley" else 1))
        nap_s = chance.uniform(*NAP_S) if kind == "nap" else 0.0
        before = sum(self._supervisor.restarts.values())
        at_s = time.monotonic() - self._supervisor.started_s
        watch = _Watch(self._supervisor, victims, self._loop, fresh=kind != "nap")
        pids = [self._supervisor.pid(name) for name in victims]
        blow = signal.SIGKILL if kind in ("kill", "volley") else signal.SIGSTOP
        for pid in pids:
            os.kill(pid, blow)
        if kind == "nap":
            watch.until(nap_s)
            _wake(pids)
        recovered_s = watch.recovered_s(f"{kind} of {', '.join(victims)}")
        return Fault(
            kind=kind,
            victims=victims,
            at_s=round(at_s, 3),
            recovered_s=round(recovered_s, 3),
            load_s=max(self._supervisor.load_s(name) for name in victims) * (kind != "nap"),
            silence_s=round(watch.silence_s, 3),
            restarts=sum(self._supervisor.restarts.values()) - before,
        )

    def settle(self) -> None:
        """Time between two faults: the spare process needs a moment, and luck is irregular."""
        rest(self._supervisor, self._chance.uniform(*SETTLE_S))


class _Watch:
    """Looks at the victims' progress and at the sensor's commands from a blow on."""

    def __init__(
        self, supervisor: Supervisor, victims: Sequence[str], loop: Any, *, fresh: bool
    ) -> None:
        self._supervisor, self._loop = supervisor, loop
        nodes = [n for name in victims for n in supervisor.plan.processes()[name]]
        accounts = [supervisor.ledger.nodes[n.index] for n in nodes]
        self._marks = [(a, a.epoch + fresh, a.handled) for a in accounts]
        self._commands, self._heard_s = loop.total, time.monotonic()
        self.silence_s = 0.0

    def until(self, seconds: float) -> None:
        """Watch for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._look()
        self._marks = [(a, epoch, a.handled) for a, epoch, _ in self._marks]

    def recovered_s(self, what: str) -> float:
        """Watch until all are back, and for as long again as commands need to flow."""
        began = time.monotonic()
        while not all(a.epoch >= epoch and a.handled > h + 1 for a, epoch, h in self._marks):
            if time.monotonic() - began > PATIENCE_S or self._supervisor.failure:
                why = self._supervisor.failure or f"nothing for {PATIENCE_S:.0f} s"
                raise click.ClickException(f"{what}: {why}")
            self._look()
        back_s = time.monotonic() - began
        commands = self._loop.total
        while self._loop.total == commands and time.monotonic() - began < back_s + PATIENCE_S:
            self._look()
        return back_s

    def _look(self) -> None:
        self._supervisor.tick()
        now_s = time.monotonic()
        self.silence_s = max(self.silence_s, now_s - self._heard_s)
        if self._loop.total != self._commands:
            self._commands, self._heard_s = self._loop.total, now_s


@click.command(cls=Bench)
@on_graph
@click.option("--minutes", default=60.0, show_default=True, type=click.FloatRange(0.1))
@click.option("--seed", default=1, show_default=True)
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], minutes: float, seed: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Do harm to a running graph for so long."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    faults: list[Fault] = []
    with Supervisor(plan) as supervisor:
        supervisor.patience = 1_000_000
        supervisor.start()
        traces = Traces.of(plan.name)
        rest(supervisor, WARM_S)
        _strike_for(supervisor, minutes * 60, seed, faults)
        duration_s = time.monotonic() - supervisor.started_s
        supervisor.finish()
        supervisor.stop()
        report = compose(plan, supervisor.ledger, {}, {}, duration_s=duration_s)
    result = {
        "bench": "chaos", **facts(), "graph": str(graph), "minutes": minutes, "seed": seed,
        "recovery": {kind: summary([f for f in faults if f.kind == kind]) for kind in KINDS},
        "unbalanced": unbalanced(report["edges"]), "orphans": traces.orphans(),
        "left": traces.files(), "loop": report["loop"], "edges": report["edges"],
        "faults": [asdict(f) for f in faults],
    }  # fmt: skip
    Console().print(_table(result))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))


def summary(faults: Sequence[Fault]) -> dict[str, float]:
    """Seconds over all faults of a kind; nothing but the count when there was none.

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


def _strike_for(supervisor: Supervisor, seconds: float, seed: int, faults: list[Fault]) -> None:
    chaos, began = Chaos(supervisor, seed), time.monotonic()
    with Progress() as progress:
        task = progress.add_task("bad luck", total=seconds)
        while (elapsed_s := time.monotonic() - began) < seconds:
            faults.append(chaos.strike())
            chaos.settle()
            words = f"{len(faults)} faults, the last {faults[-1].recovered_s:.1f} s"
            progress.update(task, completed=elapsed_s, description=words)


def _wake(pids: Sequence[int]) -> None:
    for pid in pids:
        try:
            os.kill(pid, signal.SIGCONT)
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
