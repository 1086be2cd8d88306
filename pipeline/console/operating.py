"""`fovea swap | add | remove | rewire`: orders to a running graph, and what came of them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, overload

import click

from pipeline.class_cache import adapter
from pipeline.console.arguments import BUDGET_MS, FRAMES, FRAMES_OR_NONE, named_value
from pipeline.console.watching import find
from pipeline.errors import GraphError, MessageError, RunError, SettingsError
from pipeline.fleet.remote import is_deployed, swap_there
from pipeline.graph.editing import rewired, with_nodes, without_node
from pipeline.graph.plan import Plan
from pipeline.node.operator_state import lost_words
from pipeline.protocol.codec import Refused, decode, encode, fields_of
from pipeline.protocol.orders import (
    GRAPH,
    RESULT,
    Done,
    Order,
    PlanOrder,
    Result,
    ShadowReport,
    StopOrder,
    StopResult,
    SwapOrder,
    SwapResult,
    TopologyResult,
)
from pipeline.run.bus_client import client_session
from pipeline.run.rundir import running
from pipeline.text import harmless

TIMEOUT_S = 300.0  # loading a model, a shadow run and probation take their time


@click.command()
@click.argument("graph")
@click.argument("node")
@click.option("--operator", default="", metavar="MODULE:CLASS", help="Another operator.")
@click.option("--set", "changes", multiple=True, metavar="SETTING=VALUE")
@click.option("--defaults", is_flag=True, help="Begin with the operator's own settings.")
@click.option("--shadow", default=0, type=FRAMES_OR_NONE, help="Frames to compare before.")
@click.option("--at", default=0, type=FRAMES_OR_NONE, help="Not before this frame.")
@click.option("--probation", default=30, type=FRAMES, show_default=True, help="Frames.")
@click.option("--budget-ms", default=0.0, type=BUDGET_MS, help="Per frame.")
def swap(graph: str, node: str, changes: tuple[str, ...], **order: Any) -> None:
    """Replace a node's operator, settings or model file while the graph runs."""
    wanted = dict(named_value(change) for change in changes)
    result = tell(graph, SwapOrder(node=node, changes=wanted, **order))
    for line in swap_lines(result):
        click.echo(line)


@click.command()
@click.argument("graph")
@click.argument("file", type=click.Path(path_type=Path))
def add(graph: str, file: Path) -> None:
    """Add the nodes of a FILE (`nodes:` as in a graph file) to a running graph."""
    _replan(graph, lambda plan: with_nodes(plan, file))


@click.command()
@click.argument("graph")
@click.argument("node")
def remove(graph: str, node: str) -> None:
    """Remove a node that nobody reads from a running graph."""
    _replan(graph, lambda plan: without_node(plan, node))


@click.command()
@click.argument("graph")
@click.argument("wire", metavar="NODE.INPUT=SOURCE[.OUTPUT]")
def rewire(graph: str, wire: str) -> None:
    """Let a node of a running graph read another output."""
    _replan(graph, lambda plan: rewired(plan, wire))


def _replan(graph: str, edit: Callable[[Plan], Plan]) -> None:
    for line in topology_lines(replan(graph, edit)):
        click.echo(line)


def replan(graph: str, edit: Callable[[Plan], Plan]) -> TopologyResult:
    """Have a running graph become what `edit` makes of its plan; raises `FoveaError`."""
    if is_deployed(graph) and graph not in running():
        raise RunError(f"{graph}: runs on several hosts; edit its file and `fovea up --replace`")
    _, facts = find(graph)
    wanted = edit(adapter(Plan).validate_python(facts["plan"]))
    return tell(graph, PlanOrder(plan=wanted, revision=facts["revision"]))


def topology_lines(result: TopologyResult) -> list[str]:
    """What was changed, for a terminal.

    >>> topology_lines(TopologyResult(added=["eye"], removed=[], connected=["a -> e.x"], cut=[]))
    ['added: eye', 'connected: a -> e.x']
    """
    return [f"{kind}: {', '.join(names)}" for kind, names in fields_of(result).items() if names]


@overload
def tell(graph: str, order: SwapOrder) -> SwapResult: ...
@overload
def tell(graph: str, order: PlanOrder) -> TopologyResult: ...
@overload
def tell(graph: str, order: StopOrder) -> StopResult: ...
def tell(graph: str, order: Order) -> Done:
    """Give a running graph an order; raises `RunError` or `GraphError` with its reason."""
    if isinstance(order, SwapOrder) and is_deployed(graph) and graph not in running():
        return _judged(swap_there(graph, order, TIMEOUT_S))
    name, facts = find(graph)
    with client_session(name, "order") as session:
        key = f"fovea/{facts['graph']}/{GRAPH}"
        answer = session.ask(key, _written(order), TIMEOUT_S, lambda: same_run(name, facts))
    if answer is None and not same_run(name, facts):
        raise RunError(f"{name}: ended before that was done")
    if answer is None:
        raise RunError(f"{name}: no answer for {TIMEOUT_S:.0f} s; see `fovea ps`")
    return _judged(decode(RESULT, answer))


def _written(order: Order) -> bytes:
    try:
        return encode(order)
    except MessageError as error:
        raise SettingsError(f"not an order: {harmless(str(error))}") from error


def same_run(name: str, facts: Mapping[str, Any]) -> bool:
    """Whether a graph is still in the run of which this was noted."""
    return bool(running().get(name, {}).get("run") == facts["run"])


def _judged(result: Result) -> Done:
    if isinstance(result, Refused):
        raise (RunError if result.rolled_back else GraphError)(result.reason)
    return result


def swap_lines(result: SwapResult) -> list[str]:
    """What a swap came to, for a terminal.

    >>> swap_lines(SwapResult(node="a", hot=True, seq=7, gap_ms=1.25, state="none",
    ...                       proven_frames=30))
    ['a: swapped after frame 7, stood still for 1.2 ms, state none, 30 frames of probation']

    What the operator kept and did not declare is a line of its own.
    """
    cut = f"after frame {result.seq}" if result.hot else "by stopping and starting"
    words = [
        f"{result.node}: swapped {cut}",
        f"stood still for {result.gap_ms:.1f} ms",
        *(f"left out {count} of {name}" for name, count in result.left_out.items() if count),
        f"state {result.state}",
        f"{result.proven_frames} frames of probation",
    ]
    warnings = [f"{result.node}: {lost_words(result.forgotten)}"] if result.forgotten else []
    return [", ".join(words), *warnings, *_shadow_lines(result.shadow)]


def _shadow_lines(shadow: ShadowReport | None) -> list[str]:
    if shadow is None:
        return []
    apart = [
        f"{name} in {d.frames} by up to {d.most:.3g}" for name, d in shadow.differences.items()
    ]
    line = (
        f"shadow: {shadow.frames} frames, {shadow.identical} answered alike, "
        f"{shadow.handler_ms:.1f} ms each" + (f", {shadow.missed} missed" if shadow.missed else "")
    )
    return [f"{line}; different: {', '.join(apart)}" if apart else line]
