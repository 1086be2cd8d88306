"""`fovea swap`: orders to a running graph, and what came of them."""

import os
from collections.abc import Mapping
from typing import Any

import click
import msgspec

from pipeline.bus import Session
from pipeline.desk import COMMAND, Order
from pipeline.errors import GraphError, RunError
from pipeline.overlay import read_change
from pipeline.rundir import base
from pipeline.swap import SwapOrder
from pipeline.watching import find

PATIENCE_S = 300.0  # loading a model, a shadow run and probation take their time


@click.command()
@click.argument("graph")
@click.argument("node")
@click.option("--operator", default="", metavar="MODULE:CLASS", help="Another operator.")
@click.option("--set", "changes", multiple=True, metavar="SETTING=VALUE")
@click.option("--defaults", is_flag=True, help="Begin with the operator's own settings.")
@click.option("--shadow", default=0, type=click.IntRange(0), help="Frames to compare before.")
@click.option("--at", default=0, type=click.IntRange(0), help="Not before this frame.")
@click.option("--probation", default=30, type=click.IntRange(1), show_default=True, help="Frames.")
@click.option("--budget-ms", default=0.0, type=click.FloatRange(0), help="Per frame.")
def swap(graph: str, node: str, changes: tuple[str, ...], **order: Any) -> None:
    """Replace a node's operator, settings or model file while the graph runs."""
    wanted = {}
    for change in changes:
        _, setting, value = read_change(f"{node}.{change}")
        wanted[setting] = value
    result = tell(graph, SwapOrder(node=node, changes=wanted, **order))
    for line in swap_lines(result):
        click.echo(line)


def tell(graph: str, order: Order) -> dict[str, Any]:
    """Give a running graph an order; raises `RunError` or `GraphError` with its reason."""
    name, _ = find(graph)
    own = f"order-{os.getpid()}"
    session = Session(base() / name, own)
    try:
        answer = session.ask(f"fovea/{name}/{COMMAND}", msgspec.json.encode(order), PATIENCE_S)
    finally:
        session.close()
        (base() / name / f"{own}.sock").unlink(missing_ok=True)
    if answer is None:
        raise RunError(f"{name}: no answer for {PATIENCE_S:.0f} s; see `fovea ps`")
    result: dict[str, Any] = msgspec.json.decode(answer)
    if refused := result.get("refused"):
        raise (RunError if result.get("rolled_back") else GraphError)(refused)
    return result


def swap_lines(result: Mapping[str, Any]) -> list[str]:
    """What a swap came to, for a terminal.

    >>> swap_lines({"node": "a", "hot": True, "seq": 7, "gap_ms": 1.25, "state": "none",
    ...             "proven_frames": 30})
    ['a: swapped after frame 7, stood still for 1.2 ms, state none, 30 frames of probation']
    """
    cut = f"after frame {result['seq']}" if "seq" in result else "by stopping and starting"
    words = [
        f"{result['node']}: swapped {cut}",
        f"stood still for {result['gap_ms']:.1f} ms",
        *([f"state {result['state']}"] if "state" in result else []),
        f"{result['proven_frames']} frames of probation",
    ]
    return [", ".join(words), *_shadow_lines(result.get("shadow"))]


def _shadow_lines(shadow: Mapping[str, Any] | None) -> list[str]:
    if not shadow:
        return []
    apart = [
        f"{name} in {d['frames']} by up to {d['most']:.3g}"
        for name, d in shadow["differences"].items()
    ]
    line = (
        f"shadow: {shadow['frames']} frames, {shadow['identical']} answered alike, "
        f"{shadow['handler_ms']:.1f} ms each"
    )
    return [f"{line}; different: {', '.join(apart)}" if apart else line]
