"""Shared memory of a graph's frame pools: plan and forecasts in, bytes by output and in all out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pipeline.bus.ledger import ledger_bytes
from pipeline.bus.outport import INLINE_BYTES
from pipeline.bus.pool_file import MAX_SLOTS, pool_bytes
from pipeline.contract import outputs_of
from pipeline.forecast import Forecast
from pipeline.graph.plan import Node, Plan, load_operator, slots
from pipeline.messages import Frame
from pipeline.planner.machine import Machine
from pipeline.run.memory_folder import MEMORY


@dataclass(frozen=True, kw_only=True)
class PoolRow:
    """The pool of one output that has readers."""

    output: str  # node or node.output
    host: str
    slots: int
    frame_bytes: int | None  # None: not known
    pool_bytes: int | None  # None: not known; 0: its messages are small, they need no pool
    recorded: bool = False  # by a profile; otherwise it follows from the settings


@dataclass(frozen=True, kw_only=True)
class PoolPlan:
    """All pools. The total is that of those that are known, and of the ledger."""

    rows: tuple[PoolRow, ...]
    others: int  # outputs of other messages than pictures, whose size nothing tells
    total_bytes: int
    compared: bool  # with this machine; not where the graph has hosts of its own


def pool_plan(
    plan: Plan, told: Mapping[str, Forecast], recorded: Mapping[str, int] | None = None
) -> PoolPlan:
    """Return the pools of a plan; `recorded` are sizes of pool files by `node.output`."""
    rows, others = [], 0
    for node in plan.nodes:
        for output, message in outputs_of(load_operator(node.operator)).items():
            if not plan.readers(node.name, output):
                continue  # what nothing reads stays in the process
            row = _row(plan, node, output, told[node.name], recorded or {})
            if row.pool_bytes or message is Frame:
                rows.append(row)
            elif row.pool_bytes is None:
                others += 1
    return PoolPlan(
        rows=tuple(rows),
        others=others,
        total_bytes=ledger_bytes(len(plan.edges), len(plan.nodes))
        + sum(row.pool_bytes or 0 for row in rows),
        compared=not plan.hosts,
    )


def _row(
    plan: Plan, node: Node, output: str, told: Forecast, recorded: Mapping[str, int]
) -> PoolRow:
    readers = plan.readers(node.name, output)
    stream = told.streams.get(output)
    frame_bytes = stream.frame_bytes if stream else None
    size: int | None = None
    if frame_bytes is not None:
        size = pool_bytes(slots(readers), frame_bytes) if frame_bytes > INLINE_BYTES else 0
    from_profile = size is None and bool(recorded)
    if from_profile:
        size = recorded.get(f"{node.name}.{output}", 0)
    return PoolRow(
        output=readers[0].origin, host=node.host, slots=slots(readers), frame_bytes=frame_bytes,
        pool_bytes=size, recorded=from_profile,
    )  # fmt: skip


def refused(found: PoolPlan, machine: Machine) -> Iterator[str]:
    """Yield a sentence for pools that cannot be made on this machine."""
    for row in found.rows:
        if row.slots > MAX_SLOTS and row.pool_bytes:
            yield f"{row.output}: pool: expected up to {MAX_SLOTS} slots, got {row.slots}"
    needed = found.total_bytes
    for limit, where in ((machine.shared_bytes, str(MEMORY)), (machine.memory_bytes, "memory")):
        if found.compared and limit and needed > limit:
            largest = max(found.rows, key=lambda row: row.pool_bytes or 0, default=None)
            said = f"pools: expected up to {mega(limit)} MB of {where}, got {mega(needed)} MB"
            if largest is not None:
                said += f"; the largest is {largest.output}, {mega(largest.pool_bytes)} MB"
            yield said


def doubted(found: PoolPlan, machine: Machine) -> Iterator[str]:
    """Yield a sentence where the memory is there, but in use."""
    limits = (
        (machine.shared_bytes, machine.shared_free_bytes, str(MEMORY)),
        (machine.memory_bytes, machine.memory_free_bytes, "memory"),
    )
    for limit, free, where in limits:
        if found.compared and free < found.total_bytes <= limit:
            yield (
                f"pools: {mega(found.total_bytes)} MB, but {mega(free)} of the {mega(limit)} MB of "
                f"{where} are free now"
            )


def mega(nbytes: float | None) -> str:
    """Return bytes in MB.

    >>> mega(1_234_567), mega(23_456_789), mega(0)
    ('1.2', '23', '0')
    """
    value = (nbytes or 0) / 1e6
    return f"{value:.1f}" if 0 < value < 9.95 else f"{value:.0f}"
