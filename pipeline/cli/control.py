"""`fovea set | tell | swap | add | remove | rewire | stop`: orders to a running graph."""

import json
from pathlib import Path
from typing import Any

import click

from pipeline import terminal
from pipeline.cli.arguments import (
    BUDGET_MS,
    FRAMES,
    FRAMES_OR_NONE,
    GRAPH,
    JSON,
    named_value,
    print_json,
    second,
)
from pipeline.cli.detached import ended_line
from pipeline.cli.results import swap_lines, topology_lines
from pipeline.cli.tables import settings_table
from pipeline.client import detached
from pipeline.client.find import find, graphs
from pipeline.client.graph_client import Stopped
from pipeline.errors import RunError
from pipeline.graph.overlay import shown_change
from pipeline.protocol.codec import ControlMessage, fields_of
from pipeline.protocol.orders import SwapOrder

NODE = second("node", form="GRAPH NODE")


@click.command("set")
@GRAPH
@second("node", form="GRAPH NODE SETTING=VALUE")
@click.argument("changes", nargs=-1, metavar="[SETTING=VALUE]…")
@JSON
def set_command(graph: str, node: str, changes: tuple[str, ...], as_json: bool) -> None:
    """Change live settings of a running graph; with a NODE alone, show its settings."""
    if "=" in node:
        name, dot, change = node.partition(".")
        new = f"{name} {change}" if dot and "=" not in name else f"NODE {node}"
        raise click.UsageError(
            f"{shown_change(node)}: expected NODE SETTING=VALUE: fovea set {graph} "
            f"{shown_change(new)}"
        )
    wanted = dict(named_value(change) for change in changes)  # parse all before changing any
    answer = find(graph).configure(node, wanted)
    if as_json:
        print_json({"node": node, "settings": answer.settings, "live": answer.live})
    elif wanted:
        for setting in wanted:
            click.echo(f"{node}.{setting} = {json.dumps(answer.settings.get(setting))}")
    else:
        terminal.console().print(settings_table(answer))


@click.command("tell")
@GRAPH
@NODE
@click.argument("command")
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]…")
@click.option("--json", is_flag=True, expose_value=False, help="The result is always JSON.")
def tell_command(graph: str, node: str, command: str, arguments: tuple[str, ...]) -> None:
    """Call a command of a running node; `fovea schema GRAPH NODE` lists its commands."""
    given = dict(named_value(argument) for argument in arguments)
    click.echo(json.dumps(find(graph).command(node, command, given).answer))


@click.command()
@GRAPH
@NODE
@click.option("--operator", default="", metavar="MODULE:CLASS", help="Another operator.")
@click.option("--set", "changes", multiple=True, metavar="SETTING=VALUE")
@click.option("--defaults", is_flag=True, help="Start from the operator's default settings.")
@click.option("--shadow", default=0, type=FRAMES_OR_NONE, help="Frames to run as a shadow first.")
@click.option("--fresh", is_flag=True, help="Begin without the old instance's state.")
@click.option("--at", default=0, type=FRAMES_OR_NONE, help="Earliest frame of the handover.")
@click.option("--probation", default=30, type=FRAMES, show_default=True, help="Frames.")
@click.option("--budget-ms", default=0.0, type=BUDGET_MS, help="Per frame.")
@JSON
def swap(graph: str, node: str, changes: tuple[str, ...], as_json: bool, **order: Any) -> None:
    """Replace a node's operator, settings or model file while the graph runs."""
    wanted = dict(named_value(change) for change in changes)
    result = find(graph).swap(SwapOrder(node=node, changes=wanted, **order))
    _tell(result, swap_lines(result, order["shadow"]), as_json=as_json)


@click.command()
@GRAPH
@second("file", "FILE", form="GRAPH FILE")
@JSON
def add(graph: str, file: str, as_json: bool) -> None:
    """Add the nodes of a FILE (`nodes:` as in a graph file) to a running graph."""
    result = find(graph).add(Path(file))
    _tell(result, topology_lines(result), as_json=as_json)


@click.command()
@GRAPH
@NODE
@JSON
def remove(graph: str, node: str, as_json: bool) -> None:
    """Remove a node without readers from a running graph."""
    result = find(graph).remove(node)
    _tell(result, topology_lines(result), as_json=as_json)


@click.command()
@GRAPH
@second("wire", "NODE.INPUT=SOURCE[.OUTPUT]", form="GRAPH NODE.INPUT=SOURCE[.OUTPUT]")
@JSON
def rewire(graph: str, wire: str, as_json: bool) -> None:
    """Connect an input of a node of a running graph elsewhere: NODE.INPUT=SOURCE.OUTPUT."""
    result = find(graph).rewire(wire)
    _tell(result, topology_lines(result), as_json=as_json)


def end(graph: str, *, as_json: bool) -> None:
    """Stop a graph and print how it ended; also for a detached run that has already ended."""
    ended = None if graph in graphs() else detached.noted(graph)
    if ended is not None:
        if as_json:
            print_json(
                Stopped(
                    graph=graph, stopped=False, exit_status=ended.exit_status, report=ended.report
                )
            )
        else:
            click.echo(ended_line(ended))
        return
    try:
        client = find(graph)
    except RunError as error:
        raise RunError(f"{error}; `fovea attach` finds what was deployed elsewhere") from error
    result = client.stop()
    if as_json:
        print_json(result)
        return
    status = f", exit status {result.exit_status}" if result.exit_status is not None else ""
    report = f"; report: {result.report}" if result.report else ""
    click.echo(f"{graph}: stopped{status}{report}")


@click.command("stop")
@GRAPH
@JSON
def stop(graph: str, as_json: bool) -> None:
    """Stop a running graph, here or on all its hosts, and wait until it has ended.

    As after Ctrl-C, messages in flight may arrive for up to 5 s; a second `fovea stop` does not
    wait for them.
    """
    end(graph, as_json=as_json)


def _tell(result: ControlMessage, lines: list[str], *, as_json: bool) -> None:
    if as_json:
        print_json(fields_of(result))
        return
    for line in lines:
        click.echo(line)
