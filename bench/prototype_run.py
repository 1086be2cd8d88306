"""Run a graph in real time until so many bursts were recorded and downloaded."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.progress import Progress

from bench.prototype_cycles import Cycle, Recording, cycles_of, node_file
from pipeline.client.find import find
from pipeline.errors import RunError
from pipeline.graph.editing import with_nodes
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.supervisor import Supervisor

MOST_S = 60.0  # of one cycle; more is an error
LOOK_S = 0.05  # between looks at what was recorded: less than half a preview's interval

Ask = Callable[[Mapping[str, Any]], None]  # live settings of the policy -> set
Watch = Callable[[Recording, Ask], None]  # called whenever something was recorded


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The cycles of a run after the first, and what was lost on its edges."""

    cycles: Sequence[Cycle]
    lost: Mapping[str, Any] = field(default_factory=dict)


def nothing_asked(_recording: Recording, _ask: Ask) -> None:
    """Leave the policy as the graph set it."""


def measured(
    graph: Path, changes: Sequence[str], count: int, *, title: str, watch: Watch = nothing_asked
) -> Measured:
    """Run the graph for so many cycles and one more before them, beside which processes start.

    Raises `RunError` when the graph fails or the cycles do not come in time.
    """
    with TemporaryDirectory() as folder, Progress(transient=True) as shown:
        file = Path(folder) / "cycles.jsonl"
        plan = load(graph, Overlay(changes=tuple(changes), clock="realtime"))
        plan = with_nodes(plan, node_file(file))
        task = shown.add_task(f"{plan.name}: {title}", total=count)
        recording, found = Recording(path=file), list[Cycle]()
        with Supervisor(plan) as supervisor:
            supervisor.start()
            with _asking(supervisor) as ask:
                for _ in _looks(supervisor, recording, MOST_S * (count + 2)):
                    watch(recording, ask)
                    if recording.bursts > len(found) + 1:
                        found = cycles_of(recording.lines)[1:]
                        shown.update(task, completed=len(found))
                    if len(found) >= count:
                        break
                else:
                    raise RunError(f"{plan.name}: expected {count} cycles, got {len(found)}")
            supervisor.finish()
            supervisor.stop()
            dropped = {
                f"{e.origin} -> {e.end}": supervisor.ledger.edges[e.index].report()["dropped"]
                for e in plan.edges
            }
        lost = {edge: counts for edge, counts in dropped.items() if any(counts.values())}
        return Measured(cycles=found[:count], lost=lost)


def _looks(supervisor: Supervisor, recording: Recording, limit_s: float) -> Iterator[None]:
    """Yield whenever something new was recorded, until the limit; the graph goes on meanwhile."""
    deadline_s, looked_s = time.monotonic() + limit_s, 0.0
    while (now_s := time.monotonic()) < deadline_s:
        supervisor.tick()
        if supervisor.failure:
            raise RunError(supervisor.failure)
        if now_s - looked_s > LOOK_S:
            looked_s = now_s
            if recording.update():
                yield


@contextmanager
def _asking(supervisor: Supervisor) -> Iterator[Ask]:
    """Yield what sets live settings of the policy, as `fovea set` does, while the graph goes on."""
    with ThreadPoolExecutor(1) as pool:

        def ask(values: Mapping[str, Any]) -> None:
            asked = pool.submit(find(supervisor.plan.name).configure, "policy", values)
            while not asked.done():
                supervisor.tick()
            asked.result()

        yield ask
