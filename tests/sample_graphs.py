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

# Edges that must not lose a picture hold 60, so that at 20 Hz a machine may hang for 3 s.
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
    """Return the graph with these nodes in one process, for tests of its other nodes."""
    for node in nodes:
        assert f"  {node}:\n" in text, f"no node {node}"
        text = text.replace(f"  {node}:\n", f"  {node}:\n    group: {group}\n")
    return text


def apart(text: str) -> str:
    """Return the graph with a process for every node."""
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
    """Return why each order was refused, "" for an order that was carried out."""
    return [result.reason if isinstance(result, Refused) else "" for result in results]


def swapped(result: Result) -> SwapResult:
    """Return the result of a swap that was carried out."""
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
    """Supervise the graph until the condition holds."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"timed out; failure of the run: {supervisor.failure!r}"
        supervisor.tick()


def wait_for_progress(supervisor: Supervisor, node: str, frames: int = 5) -> None:
    """Supervise the graph until a node has handled `frames` more frames."""
    before = handled(supervisor, node)
    wait_for(supervisor, lambda: handled(supervisor, node) > before + frames)


def send_signal(supervisor: Supervisor, node: str, number: signal.Signals) -> int:
    """Send a signal to the process of a running node; return its process id."""
    pid = supervisor.pid(supervisor.plan.node(node).process)
    assert pid > 0, f"{node}: expected a process, got none"  # 0 would be the tests themselves
    os.kill(pid, number)
    return pid


def beside(supervisor: Supervisor, act: Callable[[], Any]) -> Any:
    """Call `act` in another thread while the graph is supervised; return its result."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(act)
        wait_for(supervisor, done.done)
    return done.result()


def handled(supervisor: Supervisor, node: str) -> int:
    return supervisor.ledger.nodes[supervisor.plan.node(node).index].handled


def account_of(supervisor: Supervisor, end: str) -> EdgeAccount:
    """Return the account of the edge that ends at `end`, written as `node.input`."""
    index = next(e.index for e in supervisor.plan.edges if e.end == end)
    return supervisor.ledger.edges[index]


def until(holds: Callable[[], object], patience_s: float = PATIENCE_S, what: str = "it") -> None:
    end = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < end, f"{what} did not come true"
        time.sleep(0.02)


def ended(pid: int) -> bool:
    """Return whether a process has ended; a zombie has, although its status was not read yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
