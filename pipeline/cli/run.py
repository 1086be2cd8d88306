"""`fovea run | check | draw`: load a graph file with overlays, and run, check or draw it."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from pipeline import output, signals, terminal
from pipeline.cli import running
from pipeline.cli.arguments import DURATION_S, FRAMES, JSON, print_json
from pipeline.cli.detached import DetachedRun, start
from pipeline.cli.files import try_recording, try_report, write_report
from pipeline.client.detached import WORDS
from pipeline.contract import INCOMPLETE
from pipeline.errors import GraphError
from pipeline.file_arguments import GRAPH_FILE, SOURCE_FILE
from pipeline.graph.drawing import mermaid
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, manual_nodes
from pipeline.graph.plan import Plan
from pipeline.graph.schema import graph_schema
from pipeline.graph.survey import survey
from pipeline.run.reaper import Reaper
from pipeline.run.report import Report, print_report
from pipeline.run.rundir import folder_of
from pipeline.run.verdict import crashed
from pipeline.text import harmless

CRASHED = 3  # exit status of a run that completed although processes crashed
console = terminal.console()
GRAPH = click.argument("graph", type=GRAPH_FILE)


def overlaid(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that overlay a graph file."""
    for option in (
        click.option(
            "--source", type=SOURCE_FILE, help="Source of frames: a shipped one or a file."
        ),
        click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE"),
        click.option("--clock", type=click.Choice(["realtime", "lockstep"])),
        click.option("--with", "wanted", multiple=True, metavar="NODE", help="Manual node to run."),
    ):
        command = option(command)
    return command


@click.command()
@GRAPH
@overlaid
@click.option("--inline", is_flag=True, help="One thread, no processes, in lockstep.")
@click.option("--frames", type=FRAMES, help="Stop after this many exposures.")
@click.option("--duration-s", type=DURATION_S, help="Stop after this time.")
@click.option("--save", type=click.Path(path_type=Path), help="Write a Rerun recording.")
@click.option("--report", type=click.Path(path_type=Path), help="Write the report as JSON.")
@click.option("--verbose", is_flag=True, help="Print every edge and stage below the verdict.")
@click.option("--detach", is_flag=True, help="Return once it runs; `fovea stop` stops it.")
@click.option("--json", "as_json", is_flag=True, help="With --detach: print JSON.")
@click.option("--detached", type=int, hidden=True)
def run(detach: bool, as_json: bool, detached: int | None, **given: Any) -> None:
    """Run a graph until its source ends, a limit or Ctrl-C."""
    if given["frames"] and given["duration_s"]:
        raise click.UsageError("--frames and --duration-s: give one of them")
    if given["inline"] and (given["clock"] == "realtime" or given["duration_s"]):
        raise click.UsageError("--inline runs in lockstep: limit it by --frames")
    if detach and given["inline"]:
        raise click.UsageError("--detach and --inline: give one of them")
    if as_json and not detach:
        raise click.UsageError("--json: goes with --detach; `--report FILE` writes the report")
    if detach:
        _detach(given, as_json=as_json)
        return
    own = DetachedRun(detached) if detached is not None else None
    if own is None:
        status = _run(**given)
    else:
        with own.noting() as note:
            status = _run(when_it_runs=own.leave, note=note, **given)
    if status:
        sys.exit(status)


def _run(
    *, graph: Path, inline: bool, frames: int | None, duration_s: float | None,
    save: Path | None, report: Path | None, verbose: bool,
    when_it_runs: Callable[[str], None] | None = None,
    note: Callable[[int, str, Report], None] = lambda *_: None, **laid: Any,
) -> int:  # fmt: skip
    """Run in this process; return the exit status."""
    if inline:
        laid["clock"] = "lockstep"
    if report:
        try_report(report, "--report")
    if save:
        try_recording(save, "--save")
    plan, unwritten = _load(graph, save=save, **laid), ""
    for line in running.advice(plan):
        console.print(line, markup=False, soft_wrap=not console.is_terminal)
    with signals.Interruption(last=True) as asked:
        if inline:
            result = running.inline(plan, frames or 0, console, asked, verbose=verbose)
        else:
            result = running.processes(
                plan, frames or 0, duration_s or 0.0, console, asked, Reaper(), when_it_runs
            )
        if report:
            unwritten = write_report(report, result, "--report")
        print_report(console, result, verbose=verbose)
        if unwritten:
            click.echo(json.dumps(result, indent=1))
        if save:
            console.print(f"recording: {save}, open it with: rerun {save}", markup=False)
    wrong = [why for why in (result.get("failure"), result.get(INCOMPLETE), unwritten) if why]
    for why in wrong:
        output.complain(f"Error: {harmless(str(why))}")
    status = asked.status or (2 if wrong else 0)
    if not status and (said := crashed(result)):
        wrong = [f"{plan.name} ran to its end, but {harmless(said)}"]
        output.complain(f"Error: {wrong[0]}")
        status = CRASHED
    note(status, harmless("; ".join(map(str, wrong))), result)
    return status


def _detach(given: Mapping[str, Any], *, as_json: bool) -> None:
    options = {
        "--source": given["source"], "--clock": given["clock"], "--frames": given["frames"],
        "--duration-s": given["duration_s"], "--save": given["save"], "--report": given["report"],
    }  # fmt: skip
    words = [f"{name}={value}" for name, value in options.items() if value is not None]
    words += [f"--set={change}" for change in given["changes"]]
    words += [f"--with={node}" for node in given["wanted"]]
    words += ["--verbose"] if given["verbose"] else []
    graph, pid = start([*words, "--", str(given["graph"])])
    file = folder_of(graph) / WORDS
    if as_json:
        print_json({"graph": graph, "pid": pid, "words": str(file)})
        return
    click.echo(
        f"{graph}: runs, process {pid}, prints to {file}\n"
        f"look at it: fovea attach {graph}; end it: fovea stop {graph}"
    )


@click.command()
@click.argument("graph", required=False, type=GRAPH_FILE)
@overlaid
@click.option("--schema", is_flag=True, help="Print the JSON Schema of graph files.")
@click.option("--no-import", is_flag=True, help="Check only the files, without running any code.")
@JSON
def check(graph: Path | None, schema: bool, no_import: bool, as_json: bool, **laid: Any) -> None:
    """Check a graph without starting anything."""
    if no_import:
        _survey(graph, schema=schema, as_json=as_json, **laid)
        return
    plan = _load(graph, **laid) if graph else None
    if schema:
        click.echo(json.dumps(graph_schema(plan), indent=1))
    elif plan is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    elif as_json:
        print_json(
            {
                "file": str(graph),
                "name": plan.name,
                "clock": plan.clock,
                "nodes": {node.name: node.operator for node in plan.nodes},
                "processes": {p: [n.name for n in nodes] for p, nodes in plan.processes().items()},
                "edges": [{"from": edge.origin, "to": edge.end} for edge in plan.edges],
                "advice": list(running.advice(plan)),
            }
        )
    else:
        console.print(
            f"{harmless(str(graph))}: {plan.name}, {len(plan.nodes)} nodes in "
            f"{len(plan.processes())} processes, {len(plan.edges)} edges, {plan.clock}",
            markup=False,
            soft_wrap=not console.is_terminal,
        )
        for line in running.advice(plan):
            console.print(line, markup=False, soft_wrap=not console.is_terminal)


@click.command()
@GRAPH
@overlaid
def draw(graph: Path, **laid: Any) -> None:
    """Print the graph as a Mermaid flow chart."""
    click.echo(mermaid(_load(graph, **laid)))


def _survey(
    graph: Path | None, *, schema: bool, as_json: bool, source: Path | None,
    changes: tuple[str, ...], clock: str | None, wanted: tuple[str, ...],
) -> None:  # fmt: skip
    if graph is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    if schema or changes or wanted:
        raise click.UsageError("--no-import: goes with --source and --clock alone")
    lines = list(survey(graph, source=source, clock=clock or ""))
    if as_json:
        print_json({"file": str(graph), "survey": [line.strip() for line in lines]})
        return
    for line in lines:
        console.print(harmless(line), markup=False, highlight=False, soft_wrap=True)


def _load(
    graph: Path, *, save: Path | None = None, source: Path | None, changes: tuple[str, ...],
    clock: str | None, wanted: tuple[str, ...],
) -> Plan:  # fmt: skip
    values: tuple[tuple[str, str, Any], ...] = ()
    if save:
        viewer = manual_nodes(graph, "save")
        if not viewer:
            raise GraphError(f"{graph}: --save needs a node with a setting `save`, got none")
        wanted = (*wanted, viewer[0])
        values = ((viewer[0], "save", str(save)),)
    return load(graph, Overlay(source, changes, clock or "", wanted, values))
