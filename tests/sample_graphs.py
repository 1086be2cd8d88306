"""Small graphs of the samples, and functions to run one and wait for events in it."""

import os
import secrets
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil

from pipeline.bus.ledger import EdgeAccount
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import Refused, Result, SwapResult
from pipeline.run.report import Report, compose
from pipeline.run.supervisor import Supervisor

# Edges that must not lose a picture hold 60: at 20 Hz a machine may stand still for 3 s.
LOOP = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    inputs: {schedule: steer}
    settings: {rate_hz: 60, side_px: 120}
  work:
    operator: tests.samples:Pass
    inputs: {frame: ticker.context}
  pair:
    operator: tests.samples:Pair
    inputs: {left: work, right: ticker.roi}
  steer:
    operator: tests.samples:Steer
    inputs: {percept: pair}
"""
CHAIN = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {rate_hz: 20, side_px: 120}
  count:
    operator: tests.samples:Count
    inputs: {frame: {from: ticker.roi, depth: 60}}
  glance:
    operator: tests.samples:Pass
    inputs: {frame: ticker.roi}
"""
# A process costs half a second of processor time to start: only `work` has one of its own.
LOSSLESS = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    group: ends
    settings: {rate_hz: 20, side_px: 120}
  work:
    operator: tests.samples:PassEvery
    inputs: {frame: {from: ticker.context, depth: 60}}
  count:
    operator: tests.samples:Count
    group: ends
    inputs: {frame: {from: work, depth: 60}}
"""
KILLED = """
import sys
from pathlib import Path
from pipeline.graph.loader import load
from pipeline.run.supervisor import Supervisor
supervisor = Supervisor(load(Path(sys.argv[1])))
supervisor.start()
print("running", flush=True)
while True:
    supervisor.tick()
"""


PATIENCE_S = 60.0  # only for what would otherwise hang


def plan_of(tmp_path: Path, text: str, **overlay: Any) -> Plan:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: test-{secrets.token_hex(3)}\n{text}")
    return load(path, Overlay(**overlay))


def together(text: str, *nodes: str, group: str = "hand") -> str:
    """The graph with these nodes in one process: for tests that others are about."""
    for node in nodes:
        assert f"  {node}:\n" in text, f"no node {node}"
        text = text.replace(f"  {node}:\n", f"  {node}:\n    group: {group}\n")
    return text


def apart(text: str) -> str:
    """The graph with a process for every node."""
    return "".join(
        line for line in text.splitlines(keepends=True) if not line.startswith("    group:")
    )


def go(plan: Plan, frames: int, during: Callable[[Supervisor], None] | None = None) -> Report:
    with Supervisor(plan, frames=frames) as supervisor:
        supervisor.start()
        if during:
            during(supervisor)
        wait_for(supervisor, lambda: supervisor.finished, 2 * PATIENCE_S)
        supervisor.finish()
        supervisor.stop()
        report = compose(
            plan, supervisor.ledger, supervisor.reports.summaries, {}, duration_s=1,
            restarts=supervisor.restarts, crashes=supervisor.crashes,
        )  # fmt: skip
        report["failure"] = supervisor.failure
        report["summaries"] = supervisor.reports.summaries
    return report


def reasons(results: Sequence[Result]) -> list[str]:
    """Why each order was refused, "" for one that was done."""
    return [result.reason if isinstance(result, Refused) else "" for result in results]


def swapped(result: Result) -> SwapResult:
    """The result of a swap that was done."""
    assert isinstance(result, SwapResult), result
    return result


def edge(report: Report, end: str) -> dict[str, Any]:
    return next(e for e in report["edges"] if e["to"] == end)


def assert_accounts_add_up(report: Report) -> None:
    for e in report["edges"]:
        ends = e["delivered"] + sum(e["dropped"].values()) + e["lost_in_crash"]
        assert e["offered"] == ends, e
        assert e["in_flight"] == 0, e


def wait_for(
    supervisor: Supervisor, condition: Callable[[], object], timeout_s: float = PATIENCE_S
) -> None:
    """Look after the graph until the condition holds."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"timed out; the run says: {supervisor.failure!r}"
        supervisor.tick()


def wait_for_progress(supervisor: Supervisor, node: str, frames: int = 5) -> None:
    """Until a node has handled so many frames more."""
    before = handled(supervisor, node)
    wait_for(supervisor, lambda: handled(supervisor, node) > before + frames)


def send_signal(supervisor: Supervisor, node: str, number: signal.Signals) -> int:
    """Send a signal to the process of a node that runs; its process id."""
    pid = supervisor.pid(supervisor.plan.node(node).process)
    assert pid > 0, f"{node}: expected a process, got none"  # 0 would be the tests themselves
    os.kill(pid, number)
    return pid


def beside(supervisor: Supervisor, act: Callable[[], Any]) -> Any:
    """Have something done by another thread while the graph is looked after."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(act)
        wait_for(supervisor, done.done)
    return done.result()


def handled(supervisor: Supervisor, node: str) -> int:
    return supervisor.ledger.nodes[supervisor.plan.node(node).index].handled


def account_of(supervisor: Supervisor, end: str) -> EdgeAccount:
    """The account of the edge that ends there, as `node.input`."""
    index = next(e.index for e in supervisor.plan.edges if e.end == end)
    return supervisor.ledger.edges[index]


def until(holds: Callable[[], object], patience_s: float = PATIENCE_S, what: str = "it") -> None:
    end = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < end, f"{what} did not come true"
        time.sleep(0.02)


def ended(pid: int) -> bool:
    """A killed process takes a moment, and nobody may have asked yet how it ended."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
