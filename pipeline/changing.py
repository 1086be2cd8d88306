"""`fovea set`: asks a node of a running graph to change its live settings, or what they are."""

import json
import os
from collections.abc import Mapping
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from pipeline.bus import Session
from pipeline.errors import RunError
from pipeline.live import CONFIG, Answer, read_answer, write_question
from pipeline.overlay import read_change
from pipeline.rundir import base
from pipeline.settings import suggest
from pipeline.watching import find
from pipeline.wiring import key_of

PATIENCE_S = 5.0  # a node answers between two frames; one that hangs does not


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
        if answer.refused:
            raise RunError(answer.refused)
        for setting in values:
            click.echo(f"{node}.{setting} = {json.dumps(answer.settings.get(setting))}")


def ask(graph: str, node: str, changes: Mapping[str, Any]) -> Answer:
    """A node's answer; raises `RunError` when there is no such node, or none that answers."""
    name, facts = find(graph)
    nodes = [n["name"] for n in facts["nodes"]]
    if node not in nodes:
        raise RunError(f"{name}: no node {node}{suggest(node, nodes)}")
    own = f"set-{os.getpid()}"
    session = Session(base() / name, own)
    try:
        answer = session.ask(key_of(name, node, CONFIG), write_question(changes), PATIENCE_S)
    finally:
        session.close()
        (base() / name / f"{own}.sock").unlink(missing_ok=True)
    if answer is None:
        raise RunError(
            f"{name}: {node} gave no answer for {PATIENCE_S:.0f} s; see `fovea logs {node}`"
        )
    return read_answer(answer)


def table(answer: Answer) -> Table:
    """Every setting of a node and whether it can be changed now."""
    shown = Table()
    for column in ("setting", "value", "live"):
        shown.add_column(column)
    for name, value in answer.settings.items():
        shown.add_row(name, json.dumps(value), "yes" if name in answer.live else "")
    return shown
