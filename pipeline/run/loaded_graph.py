"""Graphs for scripts and notebooks: load and check, run in this thread or as processes."""

import os
import time
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from pathlib import Path

from pipeline.cores import available_cores
from pipeline.errors import RunError, SettingsError
from pipeline.graph.loader import load as load_plan
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Clock, Plan
from pipeline.graph.shipped import graph_path, source_path
from pipeline.run.inline import InlineRunner, Watch
from pipeline.run.recorded_run import as_data, profile_of
from pipeline.run.report import Report, compose
from pipeline.run.supervisor import Supervisor
from pipeline.wording import shown


def load(
    graph: str | os.PathLike[str],
    *,
    settings: Mapping[str, object] | None = None,
    source: str | os.PathLike[str] = "",
    manual: Iterable[str] = (),
    clock: Clock | None = None,
) -> "Graph":
    """Load a shipped graph by name, or a graph file by path; nothing is started.

    `settings` are values by `node.setting`; `source` is a shipped source or a file, which replaces
    the graph's source; `manual` names manual nodes to start. Raises `GraphError` or `SettingsError`
    with file and line.
    """
    if isinstance(manual, str):
        raise SettingsError(f"manual: expected a list of nodes, got {manual!r}")
    values = []
    for place, value in (settings or {}).items():
        node, dot, setting = str(place).partition(".")
        if not (node and dot and setting):
            raise SettingsError(f"settings: expected keys node.setting, got {place!r}")
        values.append((node, setting, value))
    overlay = Overlay(
        source=source_path(source) if source else None, clock=clock or "",
        wanted=tuple(manual), values=tuple(values),
    )  # fmt: skip
    return Graph(graph_path(graph), overlay)


class Graph:
    """A checked graph, which can run any number of times. `plan` holds its nodes and edges."""

    def __init__(self, path: Path, overlay: Overlay) -> None:
        self._path, self._overlay = path, overlay
        self.plan = load_plan(path, overlay)

    def __repr__(self) -> str:
        plan = self.plan
        return f"Graph({plan.name}: {len(plan.nodes)} nodes, {len(plan.edges)} edges, {plan.clock})"

    def run(
        self, frames: int = 0, *, processes: bool = False, duration_s: float = 0.0,
        watch: Watch | None = None,
    ) -> Report:  # fmt: skip
        """Run up to `frames` exposures (0: until the source ends) and return the report.

        In this thread the run is in lockstep and deterministic, and `watch` is called with
        `node.output` and each message. With `processes` it runs like `fovea run`, for at most
        `duration_s` if given; processes find your own operators in the current folder. Raises
        `RunError` for a graph that cannot continue; an operator's exception in this thread passes
        through. Crashes of processes that did not end the run are in the report's `crashes`.
        """
        limits: Mapping[str, tuple[object, type, str]] = {
            "frames": (frames, Integral, "a whole number"),
            "duration_s": (duration_s, Real, "a number"),
        }
        for name, (value, kind, expected) in limits.items():
            if not isinstance(value, kind):
                raise SettingsError(f"run.{name}: expected {expected}, got {shown(value)}")
        if frames < 0 or duration_s < 0:
            raise SettingsError(f"run: expected limits from 0 on, got {frames}, {duration_s}")
        if processes:
            if watch is not None:
                raise SettingsError("run.watch: expected none for processes, got one")
            return run_processes(self.plan, frames, duration_s)
        if duration_s:
            raise SettingsError("run.duration_s: expected it with processes=True, got it without")
        with InlineRunner(self._in_lockstep(), watch=watch) as runner:
            for _seq in runner.run(frames):
                pass
            return runner.report()

    def _in_lockstep(self) -> Plan:
        if self.plan.clock == "lockstep":
            return self.plan
        over = self._overlay
        return load_plan(
            self._path, Overlay(over.source, over.changes, "lockstep", over.wanted, over.values)
        )


def run_processes(plan: Plan, frames: int, duration_s: float) -> Report:
    """Run a plan as processes until the source ends or a limit; raises `RunError`."""
    with Supervisor(plan, frames=frames) as supervisor:
        supervisor.start()
        began_s = supervisor.started_s
        while not (supervisor.finished or supervisor.end_requests):
            if duration_s and time.monotonic() - began_s >= duration_s:
                break
            supervisor.tick()
        elapsed_s = supervisor.exposed_s
        if supervisor.begun:
            supervisor.finish()
        supervisor.stop()
        if supervisor.failure:
            raise RunError(supervisor.failure)
        return account_of(supervisor, elapsed_s)


def account_of(supervisor: Supervisor, duration_s: float) -> Report:
    """Return the report of a run whose processes have stopped."""
    report = compose(
        supervisor.plan,
        supervisor.ledger,
        supervisor.reports.summaries,
        samples := {name: supervisor.samples(name) for name in supervisor.plan.processes()},
        duration_s=duration_s,
        restarts=supervisor.restarts,
        crashes=supervisor.crashes,
        source_names=supervisor.manager.source_names,
        left_out=supervisor.reports.left_out,
    )
    profile = profile_of(
        supervisor.plan, samples, supervisor.manager.run_folder.memory.pool_bytes(),
        cores=available_cores(), since_s=supervisor.manager.exposing_since_s,
    )  # fmt: skip
    return {**report, "profile": as_data(profile)}
