"""The command line: `fovea run | check | draw | ps | top | logs | echo | hz | …`."""

import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from pipeline import output, signals
from pipeline.bus.session import silence
from pipeline.console import listening, running, watching
from pipeline.console.arguments import DURATION_S, FRAMES, FRAMES_OR_NONE, INTERVAL_S, LINES
from pipeline.console.changing import set_command
from pipeline.console.files import try_recording, try_report, write_report
from pipeline.console.graph_client import health_command, schema_command, tell_command
from pipeline.console.operating import add, remove, rewire, swap
from pipeline.console.tasks import task_command
from pipeline.contract import INCOMPLETE
from pipeline.doctor import doctor_command
from pipeline.errors import FoveaError, GraphError, RunError, SettingsError, WeightsError
from pipeline.fleet import fleet_status
from pipeline.fleet.commands import fleet_commands
from pipeline.fleet.deploy import remembered
from pipeline.graph.drawing import mermaid
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, manual_nodes
from pipeline.graph.plan import Plan
from pipeline.graph.schema import graph_schema
from pipeline.graph.survey import survey
from pipeline.run.logs import log_lines
from pipeline.run.report import tables
from pipeline.run.rundir import running as running_here
from pipeline.terminal import log_handler
from pipeline.text import error_text, harmless
from pipeline.weights import weights_commands

LOGGING = ("run", "agent")  # whose output is a log; that of the others is an answer
INTERRUPTED = 130
console = Console()
GRAPH = click.argument("graph", type=click.Path(path_type=Path, dir_okay=False))


def main() -> None:
    """Entry point: one sentence and an exit status for every expected failure and every signal."""
    output.guard()
    with signals.raising():
        sys.path.insert(0, "")  # operators of the user's own lie in the folder they work in
        logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[log_handler()])
        try:
            _carry_out()
        except OSError as error:
            if not output.is_lost(error):
                raise
            output.abandon()
            sys.exit(1)


def _carry_out() -> None:
    try:
        commands(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(INTERRUPTED)
    except FoveaError as error:
        click.echo(f"fovea: {error}", err=True)
        sys.exit(2 if isinstance(error, (GraphError, SettingsError, WeightsError)) else 1)
    except (OSError, MemoryError) as error:  # no descriptors left, no memory, a full disk
        if isinstance(error, OSError) and output.is_lost(error):
            raise
        click.echo(f"fovea: {harmless(error_text(error))}", err=True)
        sys.exit(1)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fovea")
@click.pass_context
def commands(context: click.Context) -> None:
    """Let an ultra-high-resolution image sensor decide, in real time, where to look."""
    if context.invoked_subcommand in LOGGING:
        output.forgive()
    else:
        silence()


def overlaid(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that lay something over a graph file."""
    for option in (
        click.option("--source", type=click.Path(path_type=Path), help="Where frames come from."),
        click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE"),
        click.option("--clock", type=click.Choice(["realtime", "lockstep"])),
        click.option("--with", "wanted", multiple=True, metavar="NODE", help="A manual node."),
    ):
        command = option(command)
    return command


@commands.command()
@GRAPH
@overlaid
@click.option("--inline", is_flag=True, help="One thread, no processes, in lockstep.")
@click.option("--frames", type=FRAMES, help="Stop after so many exposures.")
@click.option("--duration-s", type=DURATION_S, help="Stop after this.")
@click.option("--save", type=click.Path(path_type=Path), help="Write a Rerun recording.")
@click.option("--report", type=click.Path(path_type=Path), help="Write the report as JSON.")
def run(
    graph: Path, inline: bool, frames: int | None, duration_s: float | None,
    save: Path | None, report: Path | None, **laid: Any,
) -> None:  # fmt: skip
    """Run a graph in the foreground until its source ends, a limit, or Ctrl-C."""
    if frames and duration_s:
        raise click.UsageError("--frames and --duration-s: give one of them")
    if inline and (laid["clock"] == "realtime" or duration_s):
        raise click.UsageError("--inline runs in lockstep: limit it by --frames")
    if inline:
        laid["clock"] = "lockstep"
    if report:
        try_report(report, "--report")
    if save:
        try_recording(save, "--save")
    plan, unwritten = _load(graph, save=save, **laid), ""
    for line in running.advice(plan):
        console.print(line, markup=False)
    with signals.Interruption(last=True) as asked:
        if inline:
            result = running.inline(plan, frames or 0, console, asked)
        else:
            result = running.processes(plan, frames or 0, duration_s or 0.0, console, asked)
        if report:
            unwritten = write_report(report, result, "--report")
        console.print(tables(result))
        if unwritten:
            click.echo(json.dumps(result, indent=1))
        if save:
            console.print(f"recording: {save}, open it with: rerun {save}", markup=False)
    wrong = [why for why in (result.get("failure"), result.get(INCOMPLETE), unwritten) if why]
    for why in wrong:
        click.echo(f"Error: {harmless(str(why))}", err=True)
    if asked.status or wrong:
        sys.exit(asked.status or 2)


@commands.command()
@click.argument("graph", required=False, type=click.Path(path_type=Path, dir_okay=False))
@overlaid
@click.option("--schema", is_flag=True, help="Print the JSON Schema of graph files.")
@click.option("--no-import", is_flag=True, help="Look at the files alone, execute nothing of them.")
def check(graph: Path | None, schema: bool, no_import: bool, **laid: Any) -> None:
    """Check a graph without starting anything."""
    if no_import:
        _survey(graph, schema=schema, **laid)
        return
    plan = _load(graph, **laid) if graph else None
    if schema:
        click.echo(json.dumps(graph_schema(plan), indent=1))
    elif plan is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    else:
        console.print(
            f"{harmless(str(graph))}: {plan.name}, {len(plan.nodes)} nodes in "
            f"{len(plan.processes())} processes, {len(plan.edges)} edges, {plan.clock}",
            markup=False,
        )
        for line in running.advice(plan):
            console.print(line, markup=False)


@commands.command()
@GRAPH
@overlaid
def draw(graph: Path, **laid: Any) -> None:
    """Print the graph as a Mermaid flow chart."""
    click.echo(mermaid(_load(graph, **laid)))


@commands.command()
@click.option("--json", "as_json", is_flag=True, help="What the hosts say of deployed graphs.")
def ps(as_json: bool) -> None:
    """List the running graphs and their processes, on all hosts."""
    if as_json:
        click.echo(fleet_status.fleet_json(remembered()))
        return
    console.print(watching.process_table())
    if known := remembered():
        console.print(fleet_status.fleet_table(known))


@commands.command()
@click.argument("graph", required=False)
@click.option("--once", is_flag=True, help="Print one table and leave.")
@click.option("--every-s", default=1.0, type=INTERVAL_S, show_default=True)
def top(graph: str | None, once: bool, every_s: float) -> None:
    """Watch rates, latencies, drops and back-pressure of a running graph."""
    deployed = None if _runs_here(graph or "") else fleet_status.known_graph(graph or "")
    if deployed:
        fleet_status.fleet_top(*deployed, every_s, once=once, console=console)
    else:
        watching.top(graph or "", every_s, once=once, console=console)


@commands.command()
@click.argument("node")
@click.option("--graph", default="", help="Which graph, when several run.")
@click.option("--follow", "-f", is_flag=True)
@click.option("--lines", "-n", default=40, type=LINES, show_default=True)
def logs(node: str, graph: str, follow: bool, lines: int) -> None:
    """Show what a node wrote, also after it ended."""
    try:
        found = log_lines(graph, node, lines, follow=follow)
        for line in found:
            click.echo(line)
    except RunError:
        if follow or not remembered():
            raise
        for line in fleet_status.fleet_log(graph, node, lines):
            click.echo(line)


@commands.command()
@click.argument("output", metavar="NODE[.OUTPUT]")
@click.option("--graph", default="", help="Which graph, when several run.")
@click.option("--count", default=0, type=FRAMES_OR_NONE, help="Leave after so many.")
def echo(output: str, graph: str, count: int) -> None:
    """Print the messages of an output as they come."""
    for line in listening.echo(graph, output, count):
        click.echo(line)


@commands.command()
@click.argument("output", metavar="NODE[.OUTPUT]")
@click.option("--graph", default="", help="Which graph, when several run.")
@click.option("--duration-s", default=5.0, type=INTERVAL_S, show_default=True)
def hz(output: str, graph: str, duration_s: float) -> None:
    """Measure rate, jitter and age of an output's messages."""
    click.echo(listening.rate(graph, output, duration_s))


def _runs_here(graph: str) -> bool:
    found = running_here()
    return graph in found or (not graph and bool(found))


def _survey(
    graph: Path | None, *, schema: bool, source: Path | None, changes: tuple[str, ...],
    clock: str | None, wanted: tuple[str, ...],
) -> None:  # fmt: skip
    if graph is None:
        raise click.UsageError("Missing argument 'GRAPH'.")
    if schema or changes or wanted:
        raise click.UsageError("--no-import: goes with --source and --clock alone")
    for line in survey(graph, source=source, clock=clock or ""):
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


commands.add_command(weights_commands)
for fleet_command in fleet_commands:
    commands.add_command(fleet_command)
commands.add_command(set_command)
commands.add_command(doctor_command)
commands.add_command(health_command)
commands.add_command(schema_command)
commands.add_command(tell_command)
for order in (swap, add, remove, rewire):
    commands.add_command(order)
commands.add_command(task_command("train", "Train the networks of a task."))
commands.add_command(task_command("eval", "Measure a task: figures, tables, plots."))

if __name__ == "__main__":
    main()
