"""Health of a node, from its accounts alone, so that it is known even for a node that hangs.

Progress is the criterion. A node is stalled when it does not finish a message, or when it has no
heartbeat; waiting for input, for credit, for a model or, as long as it says, for a lost device is
healthy.
"""

import os
import time

import psutil

from pipeline.bus.ledger import Ledger, NodeAccount
from pipeline.graph.plan import Node, Plan
from pipeline.protocol.questions import Health

FROZEN_S = 3.0  # without a heartbeat for this long, the process is frozen


def problem(node: Node, account: NodeAccount, now_ns: int) -> str:
    """Return why a node is stalled, or an empty string.

    The state is read before the times, and written after them, so that the state cannot have begun
    before these times.
    """
    state = account.condition
    busy_s = busy_ns(account, now_ns) / 1e9
    silent_s = (now_ns - account.heartbeat_ns) / 1e9
    if state == "busy" and busy_s > node.stall_s:
        return f"{node.name} has worked on frame {account.last_seq} for {busy_s:.1f} s"
    if state in ("waiting", "credit") and silent_s > FROZEN_S:
        return f"{node.name} gave no sign of life for {silent_s:.1f} s"
    return ""


def examine(plan: Plan, node: Node, ledger: Ledger, words: str = "") -> Health:
    """Return the health of a node of this process."""
    account, now_ns = ledger.nodes[node.index], time.monotonic_ns()
    state = account.condition
    ins = {name: ledger.edges[e.index] for name, e in plan.inputs(node.name).items()}
    outs = [e for e in plan.edges if e.source == node.name and ledger.edges[e.index].broken]
    worked_ns = busy_ns(account, now_ns) if state == "busy" else 0
    if state == "busy" and account.absent_until_ns > now_ns:
        state = "absent"
    return Health(
        node=node.name,
        process=node.process,
        host=node.host,
        pid=os.getpid(),
        epoch=account.epoch,
        state=state,
        problem=problem(node, account, now_ns),
        handled=account.handled,
        last_seq=account.last_seq,
        busy_s=round(worked_ns / 1e9, 3),
        silent_s=round(max(0, now_ns - account.heartbeat_ns) / 1e9, 3),
        own_mb=round(own_mb(psutil.Process()), 1),
        words=words,
        waiting={name: edge.in_flight for name, edge in ins.items()},
        dropped={name: edge.report()["dropped"] for name, edge in ins.items()},
        broken=tuple(e.end for e in outs),
    )


def busy_ns(account: NodeAccount, now_ns: int) -> int:
    """Return how long a message has been in work; waiting for a lost device does not count."""
    return max(0, now_ns - max(account.busy_since_ns, account.absent_until_ns))


def own_mb(process: psutil.Process) -> float:
    """Return resident memory in MB that is not mapped from files: no pools, no libraries."""
    memory = process.memory_info()
    return float(memory.rss - memory.shared) / 1e6
