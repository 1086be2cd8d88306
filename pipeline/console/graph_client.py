"""The client of running graphs, here or on several hosts: `fovea health | schema | tell`."""

import json
from collections.abc import Collection, Mapping
from functools import partial
from typing import Any, TypeVar

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline.console.arguments import named_value
from pipeline.console.watching import find
from pipeline.errors import RunError
from pipeline.fleet.deploy import remembered
from pipeline.fleet.remote import ask_there, health_there, is_deployed
from pipeline.node.wiring import key_of
from pipeline.protocol.codec import decode_answer, encode, fields_of
from pipeline.protocol.questions import (
    HEALTH,
    Command,
    Health,
    HealthQuestion,
    Interface,
    NodeQuestion,
    Outcome,
    SchemaQuestion,
)
from pipeline.run.bus_client import ask_local, client_session
from pipeline.run.rundir import running
from pipeline.settings import suggest
from pipeline.terminal import lean_table

T = TypeVar("T")
QUICK_S = 3.0  # what transports answer by themselves; a process that is frozen does not


@click.command("health")
@click.argument("graph", required=False)
@click.option("--json", "as_json", is_flag=True, help="One object per node.")
def health_command(graph: str | None, as_json: bool) -> None:
    """Ask every node of a running graph, or of all of them, how it is; on all hosts."""
    names = [graph] if graph else sorted({*running(), *remembered()})
    if not names:
        raise RunError("expected a running graph, got none")
    found = {name: fleet_health(name) for name in names}
    if as_json:
        plain = {g: {n: _plain(h) for n, h in nodes.items()} for g, nodes in found.items()}
        click.echo(json.dumps(plain, indent=1))
    else:
        Console().print(health_table(found))
    mute = [f"{g}/{n}" for g, nodes in found.items() for n, h in nodes.items() if h is None]
    if mute:
        raise RunError(f"no answer from {', '.join(mute)}")


@click.command("schema")
@click.argument("node")
@click.option("--graph", default="", help="Which graph, when several run.")
def schema_command(node: str, graph: str) -> None:
    """Print what a running node takes and gives, its settings and its commands."""
    found = ask_node(graph, node, SchemaQuestion(), Interface)
    click.echo(json.dumps(fields_of(found), indent=1))


@click.command("tell")
@click.argument("graph")
@click.argument("node")
@click.argument("command")
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]…")
def tell_command(graph: str, node: str, command: str, arguments: tuple[str, ...]) -> None:
    """Have a running node do something; `fovea schema NODE` shows what it can."""
    given = dict(named_value(argument) for argument in arguments)
    click.echo(json.dumps(tell(graph, node, command, given).answer))


def tell(graph: str, node: str, command: str, arguments: Mapping[str, Any]) -> Outcome:
    """What a command returned; raises `RunError` when the node refuses or does not answer."""
    return ask_node(graph, node, Command(command, dict(arguments)), Outcome)


def fleet_health(graph: str) -> dict[str, Health | None]:
    """What every node of a running graph says, here or on hosts; None for who is silent."""
    if is_deployed(graph) and graph not in running():
        return health_there(graph)
    name, facts = find(graph)
    key = partial(key_of, facts["graph"])
    wanted = {key(node["name"], HEALTH): node["name"] for node in facts["nodes"]}
    with client_session(name, "health") as session:
        answers = session.ask_all(
            key("*", HEALTH), encode(HealthQuestion()), QUICK_S, _complete(wanted)
        )
    return {
        node: decode_answer(Health, answers[key]) if key in answers else None
        for key, node in wanted.items()
    }


def ask_node(graph: str, node: str, question: NodeQuestion, answer: type[T]) -> T:
    """One node's answer; raises `RunError` when it refuses, does not answer or is not there."""
    if is_deployed(graph) and graph not in running():
        return decode_answer(answer, ask_there(graph, node, question))
    name, facts = find(graph)
    nodes = [n["name"] for n in facts["nodes"]]
    if node not in nodes:
        raise RunError(f"{name}: no node {node}{suggest(node, nodes)}")
    return decode_answer(answer, ask_local(name, facts["graph"], node, question))


def health_table(found: Mapping[str, Mapping[str, Health | None]]) -> Table:
    """A line per node: who does not answer, who stalls, who loses."""
    table = lean_table(
        names=("graph", "node", "state"), words=("what is wrong",),
        figures=("pid", "epoch", "frame", "own MB"),
    )  # fmt: skip
    for graph, nodes in found.items():
        for node, health in nodes.items():
            if health is None:
                silent = Text("no answer", "red")
                table.add_row(Text(graph), Text(node), "", silent)
                continue
            broken = [f"{end} lost messages it was promised" for end in health.broken]
            wrong = "; ".join(filter(None, [health.problem, *broken]))
            table.add_row(
                Text(graph), Text(node), Text(health.state), Text(wrong), str(health.pid),
                str(health.epoch), str(health.last_seq), f"{health.own_mb:.0f}",
            )  # fmt: skip
    return table


def _plain(health: Health | None) -> Any:
    return None if health is None else fields_of(health)


def _complete(wanted: Collection[str]) -> Any:
    return lambda answers: set(wanted) <= set(answers)
