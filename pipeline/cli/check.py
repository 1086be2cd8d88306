"""`fovea check`: load a graph file with overlays, and tell whether it can work here."""

import json
from pathlib import Path
from typing import Any

import click
from rich.text import Text

from pipeline import terminal
from pipeline.cli.arguments import JSON, print_json
from pipeline.cli.overlaid import load_overlaid, overlaid
from pipeline.cli.running import advice, built_settings
from pipeline.errors import SettingsError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.plan import Plan
from pipeline.graph.schema import graph_schema
from pipeline.graph.shipped import name_of
from pipeline.graph.survey import survey
from pipeline.planner.links import LINKS
from pipeline.planner.machine import this_machine
from pipeline.planner.planner import Examination, examine
from pipeline.planner.tables import tables
from pipeline.run.recorded_run import read_profile
from pipeline.text import harmless

console = terminal.console()


@click.command()
@click.argument("graph", required=False, type=GRAPH_FILE)
@overlaid
@click.option(
    "--profile", type=click.Path(path_type=Path),
    help="Report of a run (`fovea run --report`), for delay, CPU and memory.",
)  # fmt: skip
@click.option("--link", type=click.Choice(list(LINKS)), help="Link that the sensor has to fit.")
@click.option("--ask", is_flag=True, help="Open the sensor, and ask what it will send.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of graph files.")
@click.option("--no-import", is_flag=True, help="Check only the files, without running any code.")
@JSON
def check(
    graph: Path | None, profile: Path | None, link: str | None, ask: bool, schema: bool,
    no_import: bool, as_json: bool, **laid: Any,
) -> None:  # fmt: skip
    """Check a graph without starting anything."""
    if (no_import or schema or graph is None) and (profile or link or ask):
        raise click.UsageError("--profile, --link, --ask: go with a GRAPH whose code is run")
    if no_import:
        _survey(graph, schema=schema, as_json=as_json, **laid)
        return
    plan = load_overlaid(graph, **laid) if graph else None
    if schema:
        click.echo(json.dumps(graph_schema(plan), indent=1))
        return
    if graph is None or plan is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    run = read_profile(profile, plan) if profile else None
    settings = built_settings(plan)
    if not as_json:
        _print_summary(graph, plan)
        _print_lines(list(advice(plan, settings)))
    found = examine(plan, settings, this_machine(), run=run, link=link or "", ask=ask)
    if as_json:
        _print_data(graph, plan, list(advice(plan, settings)), found)
    else:
        _print_tables(found, name_of(graph))
    if found.refusals:
        raise SettingsError("; ".join(harmless(said) for said in found.refusals))


def _print_data(graph: Path, plan: Plan, lines: list[str], found: Examination) -> None:
    print_json(
        {
            "file": str(graph),
            "name": plan.name,
            "clock": plan.clock,
            "nodes": {node.name: node.operator for node in plan.nodes},
            "processes": {p: [n.name for n in nodes] for p, nodes in plan.processes().items()},
            "edges": [{"from": edge.origin, "to": edge.end} for edge in plan.edges],
            "advice": lines,
            "plan": found,
        }
    )


def _print_summary(graph: Path, plan: Plan) -> None:
    _print_lines(
        [
            f"{harmless(str(graph))}: {plan.name}, {len(plan.nodes)} nodes in "
            f"{len(plan.processes())} processes, {len(plan.edges)} edges, {plan.clock}"
        ]
    )


def _print_lines(lines: list[str], style: str = "") -> None:
    for line in lines:
        soft = not console.is_terminal
        console.print(line, markup=False, soft_wrap=soft, style=style or None)


def _print_tables(found: Examination, graph: str) -> None:
    console.print()
    for part in tables(found, graph):
        console.print(part, soft_wrap=isinstance(part, Text) and not console.is_terminal)
    if found.warnings:
        console.print()
        _print_lines([f"warning: {harmless(said)}" for said in found.warnings], "yellow")


def _survey(
    graph: Path | None, *, schema: bool, as_json: bool, source: Path | None,
    changes: tuple[str, ...], clock: str | None, wanted: tuple[str, ...], settings: Path | None,
) -> None:  # fmt: skip
    if graph is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    if schema or changes or wanted or settings:
        raise click.UsageError("--no-import: goes with --source and --clock alone")
    lines = list(survey(graph, source=source, clock=clock or ""))
    if as_json:
        print_json({"file": str(graph), "survey": [line.strip() for line in lines]})
        return
    for line in lines:
        console.print(harmless(line), markup=False, highlight=False, soft_wrap=True)
