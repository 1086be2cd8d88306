"""`fovea set`: asks a node of a running graph to change its live settings, or what they are."""

import json
from collections.abc import Mapping
from typing import Any

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline.console.graph_client import ask_node
from pipeline.fleet.remote import is_deployed, set_there
from pipeline.graph.overlay import read_change
from pipeline.protocol.questions import ConfigQuestion, NodeSettings
from pipeline.run.rundir import running
from pipeline.terminal import lean_table


@click.command("set")
@click.argument("graph")
@click.argument("changes", nargs=-1, required=True, metavar="NODE.SETTING=VALUE… | NODE")
def set_command(graph: str, changes: tuple[str, ...]) -> None:
    """Change live settings of a running graph; with a NODE alone, show its settings."""
    if len(changes) == 1 and "=" not in changes[0]:
        Console().print(table(ask(graph, changes[0], {})))
        return
    wanted: dict[str, dict[str, Any]] = {}
    for node, setting, value in [read_change(change) for change in changes]:  # all, before any
        wanted.setdefault(node, {})[setting] = value
    for node, values in wanted.items():
        answer = ask(graph, node, values)
        for setting in values:
            click.echo(f"{node}.{setting} = {json.dumps(answer.settings.get(setting))}")


def ask(graph: str, node: str, changes: Mapping[str, Any]) -> NodeSettings:
    """A node's settings; raises `RunError` when it refuses, does not answer or is not there."""
    if changes and is_deployed(graph) and graph not in running():
        return set_there(graph, node, changes)
    return ask_node(graph, node, ConfigQuestion(dict(changes)), NodeSettings)


def table(answer: NodeSettings) -> Table:
    """Every setting of a node and whether it can be changed now."""
    shown = lean_table(names=("setting",), words=("value", "live"))
    for name, value in answer.settings.items():
        shown.add_row(Text(name), Text(json.dumps(value)), "yes" if name in answer.live else "")
    return shown
