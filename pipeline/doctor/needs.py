"""Check the needs of a graph by sending one frame through it in this process."""

import os
import resource
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

from pipeline.bus.ledger import ledger_bytes
from pipeline.bus.outport import INLINE_BYTES
from pipeline.bus.pool_file import pool_bytes as pool_file_bytes
from pipeline.contract import outputs_of
from pipeline.cores import available_cores
from pipeline.doctor.finding import Finding, ok, warning, wrong
from pipeline.doctor.machine import open_files
from pipeline.errors import FoveaError, WeightsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan, load_operator, slots
from pipeline.messages import Message
from pipeline.run.inline import InlineRunner
from pipeline.run.memory_folder import MEMORY
from pipeline.run.rundir import running

CROWDED = 4  # processes per core at which scheduling delays become visible
BASE_FILES = 48  # of interpreter, transport and logs
NODE_MB = 60.0  # an interpreter with numpy, before any model


def examine_graph(path: Path, overlay: Overlay, *, trial: bool = True) -> Iterator[Finding]:
    """Yield all findings on a graph; only one if it cannot be loaded."""
    try:
        plan = load(path, overlay)
    except FoveaError as error:
        yield wrong("graph", str(error), "correct the file")
        return
    processes = plan.processes()
    yield ok("graph", f"{plan.name}: {len(plan.nodes)} nodes in {len(processes)} processes")
    yield crowd(len(processes), available_cores())
    yield open_files(resource.getrlimit(resource.RLIMIT_NOFILE), busiest_files(plan))
    yield memory(plan, psutil.virtual_memory().available / 1e6)
    if plan.name in running():
        yield ok("trial", f"{plan.name} runs now: see `fovea health {plan.name}`")
    elif trial:
        yield from tried(plan)


def tried(plan: Plan) -> Iterator[Finding]:
    """Send one frame through every operator, to load models and measure pictures."""
    try:
        with _quiet():
            sizes = message_bytes(plan)
    except WeightsError as error:
        yield wrong("trial", str(error), "fovea weights list")
    except FoveaError as error:
        yield wrong("trial", str(error), "fovea check, then the settings of that node")
    except Exception as error:
        why = f"an operator failed on the first frame: {type(error).__name__}: {error}"
        yield wrong("trial", why, "fovea run --inline --frames 1 shows where")
    else:
        yield ok("trial", f"one frame went through all {len(plan.nodes)} nodes")
        free = os.statvfs(MEMORY)
        yield pools(pool_bytes(plan, sizes), free.f_bavail * free.f_frsize)


def message_bytes(plan: Plan) -> dict[str, int]:
    """Return the bytes of large arrays in the first message of every `node.output`."""
    sizes: dict[str, int] = {}

    def look(name: str, message: Message) -> None:
        arrays = [v for v in vars(message).values() if isinstance(v, np.ndarray)]
        sizes[name] = sum(a.nbytes for a in arrays if a.nbytes > INLINE_BYTES)

    with InlineRunner(plan, watch=look) as runner:
        for _seq in runner.run(1):
            pass
    return sizes


def pool_bytes(plan: Plan, sizes: Mapping[str, int]) -> int:
    """Return the shared memory in bytes of the ledger and all pools, including readers' slots."""
    total = ledger_bytes(len(plan.edges), len(plan.nodes))
    for node in plan.nodes:
        for output in outputs_of(load_operator(node.operator)):
            size = sizes.get(f"{node.name}.{output}", 0)
            if size:
                total += pool_file_bytes(slots(plan.readers(node.name, output)), size)
    return total


def pools(needed: int, free: int) -> Finding:
    """Check for shared memory for the frame pools, in bytes."""
    found = f"{needed / 1e6:.0f} MB for the frame pools, {free / 1e6:.0f} MB free in {MEMORY}"
    if needed > free:
        size_mb = -(-needed // (1 << 20)) * 2
        todo = f"mount -o remount,size={size_mb}M {MEMORY}, or less depth on edges with pictures"
        return wrong("pools", found, todo)
    if 2 * needed > free:
        return warning("pools", found, "a swap needs a second pool for a moment: give it twice")
    return ok("pools", found)


def crowd(processes: int, cores: float) -> Finding:
    """Check that processes do not compete for cores."""
    found = f"{processes} processes on {cores:g} cores"
    if processes > CROWDED * cores:
        return warning("crowd", found, "group nodes that are quick (`group:`), or more cores")
    return ok("crowd", found)


def busiest_files(plan: Plan) -> int:
    """Estimate the open files of the busiest process: links, receivers and pools."""
    ports = max(sum(e.source == n.name or e.target == n.name for e in plan.edges)
                for n in plan.nodes)  # fmt: skip
    return BASE_FILES + 4 * len(plan.processes()) + 6 * ports


def memory(plan: Plan, free_mb: float) -> Finding:
    """Check that the memory that nodes may use is available."""
    allowed = [n.memory_mb or NODE_MB for n in plan.nodes]
    found = f"{sum(allowed):.0f} MB for {len(allowed)} nodes, {free_mb:.0f} MB available"
    if sum(allowed) > free_mb:
        return warning("memory", found, "lower `memory_mb`, end other programs, or add memory")
    return ok("memory", found)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the output of operators and libraries during the trial."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
