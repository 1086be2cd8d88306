"""`fovea ps | top | logs | echo | hz`: looking at graphs that run, here and on other hosts."""

import click
from rich.console import Console

from pipeline.console import listening, watching
from pipeline.console.arguments import FRAMES_OR_NONE, INTERVAL_S, LINES
from pipeline.errors import RunError
from pipeline.fleet import fleet_status
from pipeline.fleet.deploy import remembered
from pipeline.run.logs import log_lines
from pipeline.run.rundir import running as running_here

console = Console()


@click.command()
@click.option("--json", "as_json", is_flag=True, help="What the hosts say of deployed graphs.")
def ps(as_json: bool) -> None:
    """List the running graphs and their processes, on all hosts."""
    if as_json:
        click.echo(fleet_status.fleet_json(remembered()))
        return
    console.print(watching.process_table())
    if known := remembered():
        console.print(fleet_status.fleet_table(known))


@click.command()
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


@click.command()
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


@click.command()
@click.argument("output", metavar="NODE[.OUTPUT]")
@click.option("--graph", default="", help="Which graph, when several run.")
@click.option("--count", default=0, type=FRAMES_OR_NONE, help="Leave after so many.")
def echo(output: str, graph: str, count: int) -> None:
    """Print the messages of an output as they come."""
    for line in listening.echo(graph, output, count):
        click.echo(line)


@click.command()
@click.argument("output", metavar="NODE[.OUTPUT]")
@click.option("--graph", default="", help="Which graph, when several run.")
@click.option("--duration-s", default=5.0, type=INTERVAL_S, show_default=True)
def hz(output: str, graph: str, duration_s: float) -> None:
    """Measure rate, jitter and age of an output's messages."""
    click.echo(listening.rate(graph, output, duration_s))


def _runs_here(graph: str) -> bool:
    found = running_here()
    return graph in found or (not graph and bool(found))
