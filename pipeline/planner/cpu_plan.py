"""CPU of a graph at the asked rate, from a recorded run: cores by process and in all."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pipeline.graph.plan import Plan
from pipeline.planner.machine import Machine
from pipeline.planner.rates import below
from pipeline.run.recorded_run import ProcessProfile, RecordedRate, RecordedRun, digest
from pipeline.run.verdict import HELD_SHARE

BUSY = 0.8  # share of the cores above which peaks have no room


@dataclass(frozen=True, kw_only=True)
class CpuRow:
    """The CPU time of one process."""

    process: str
    nodes: tuple[str, ...]
    ms_per_frame: float  # of each exposure, if every message is handled
    cores: float | None  # at the asked rate; None: that is not known
    # by node, of the time in handlers, waiting included; empty: one node, or not recorded
    shares: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CpuPlan:
    """All processes of the plan that the profile knows."""

    rate_hz: float  # 0: not known
    cores: float | None  # the sum
    rows: tuple[CpuRow, ...]
    recorded: str  # in words
    short: str  # in words, by how much the recorded run fell short of its rate; empty: it held it
    missing: tuple[str, ...]  # nodes that the profile does not have
    changed: tuple[str, ...]  # nodes that were recorded with other settings


def cpu_plan(plan: Plan, run: RecordedRun, rate_hz: float) -> CpuPlan:
    """Return the need at this rate; 0: at the one that was asked for in the recorded run."""
    profile, rate = run.profile, run.rate
    assert profile is not None  # `read_profile` refuses others
    assert rate is not None
    # in lockstep there is no rate to hold
    asked_hz = (rate_hz or rate.asked_hz or 0.0) if plan.clock == "realtime" else 0.0
    here = {node.name: digest(node) for node in plan.nodes}
    rows = [
        _row(plan, run, name, process, asked_hz)
        for name, process in profile.processes.items()
        if here.keys() & set(process.nodes)
    ]
    measured = {node for row in rows for node in row.nodes}
    return CpuPlan(
        rate_hz=asked_hz,
        cores=sum(row.cores or 0.0 for row in rows) if asked_hz else None,
        rows=tuple(sorted(rows, key=lambda row: -row.ms_per_frame)),
        recorded=f"{rate.frames} frames in {run.duration_s:.0f} s on {profile.cores:g} cores",
        short=_short(rate),
        missing=tuple(name for name in here if name not in measured),
        changed=tuple(
            name for name in here if name in measured and profile.settings.get(name) != here[name]
        ),
    )


def _row(
    plan: Plan, run: RecordedRun, name: str, process: ProcessProfile, rate_hz: float
) -> CpuRow:
    frames = run.rate.frames if run.rate else 0
    seconds = process.cores * run.duration_s / frames * unhandled(plan, run, process)
    return CpuRow(
        process=name, nodes=process.nodes, ms_per_frame=1000 * seconds,
        cores=seconds * rate_hz if rate_hz else None, shares=shares_of(run, process.nodes),
    )  # fmt: skip


def shares_of(run: RecordedRun, nodes: Sequence[str]) -> tuple[float, ...]:
    """Return each node's share of the time that a group spent in handlers; empty: not known.

    It is estimated as messages handled times the median time of one. CPU is measured by process
    only: the time of a handler is that of a clock, in which it may have waited.
    """
    stages = {stage.node: stage for stage in run.stages}
    found = [stages[node] for node in nodes if node in stages]
    spent = [s.handled * s.latency_ms.p50 for s in found if s.latency_ms is not None]
    if len(nodes) < 2 or len(spent) < len(nodes) or not sum(spent):
        return ()
    return tuple(ms / sum(spent) for ms in spent)


def _short(rate: RecordedRate) -> str:
    if not rate.asked_hz or rate.achieved_hz >= HELD_SHARE * rate.asked_hz:
        return ""
    return f"{rate.achieved_hz:.4g} of {rate.asked_hz:.4g} Hz"


def unhandled(plan: Plan, run: RecordedRun, process: ProcessProfile) -> float:
    """Return what was sent to the busiest node of a process per message that it handled, >= 1.

    A node that dropped frames took less time than it takes to handle them all.
    """
    offered = {edge.to: edge.offered for edge in run.edges}
    handled = {stage.node: stage.handled for stage in run.stages}
    most = 1.0
    for node in plan.nodes:
        if node.name not in process.nodes or not handled.get(node.name):
            continue
        edges = [e for e in plan.inputs(node.name).values() if not e.command and e.end in offered]
        sets = max((offered[e.end] for e in edges if e.join), default=0)
        alone = sum(offered[e.end] for e in edges if not e.join)
        most = max(most, (sets + alone) / handled[node.name])
    return most


def refused(found: CpuPlan, machine: Machine) -> Iterator[str]:
    """Yield a sentence where the graph needs more cores than there are."""
    if found.cores is not None and found.cores > machine.cores:
        most = ", ".join(f"{row.process} {row.cores or 0:.2f}" for row in found.rows[:3])
        fits_hz = found.rate_hz * machine.cores / found.cores
        yield (
            f"CPU: expected up to {machine.cores:g} cores, got {found.cores:.2f} at "
            f"{found.rate_hz:.4g} Hz, most of it {most}; at most {below(fits_hz)} Hz"
        )


def doubted(found: CpuPlan, machine: Machine) -> Iterator[str]:
    """Yield a sentence where little is left, or where the profile says little."""
    if found.short:
        yield (
            f"profile: its run fell short of its rate, {found.short}: delay and CPU are those of "
            "that run, on a machine that was too busy or too slow"
        )
    if found.cores is not None and BUSY * machine.cores < found.cores <= machine.cores:
        yield (
            f"CPU: {found.cores:.2f} of {machine.cores:g} cores at {found.rate_hz:.4g} Hz leave "
            "little for peaks"
        )
