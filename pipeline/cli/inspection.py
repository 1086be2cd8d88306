"""`fovea ps | top | health | schema | logs | echo | hz`: inspect running graphs."""

import itertools
import time
from collections.abc import Iterator

import click
import msgspec
from rich.live import Live

from pipeline import terminal
from pipeline.cli import tables
from pipeline.cli.arguments import (
    FRAMES_OR_NONE,
    GRAPH,
    INTERVAL_S,
    JSON,
    LINES,
    RUNNING,
    print_json,
    second,
)
from pipeline.cli.detached import ended_line
from pipeline.client import detached, listening
from pipeline.client import find as clients
from pipeline.client.graph_client import GraphClient, Status
from pipeline.client.live_figures import live_figures
from pipeline.errors import RunError
from pipeline.protocol.codec import fields_of
from pipeline.renamed import renamed_option
from pipeline.terminal import cropped
from pipeline.text import harmless

MOST_LINE = 20_000  # characters of a message on one line
NODE = second("node", form="GRAPH NODE")
OUTPUT = second("output", "NODE[.OUTPUT]", form="GRAPH NODE[.OUTPUT]")


@click.command()
@JSON
def ps(as_json: bool) -> None:
    """List the running graphs and their processes, on all hosts."""
    found = clients.statuses()
    names = {status.graph for status in found}
    ended = {name: one for name, one in detached.all_noted().items() if name not in names}
    if as_json:
        running = {status.graph: {"hosts": status.hosts, "nodes": status.nodes} for status in found}
        print_json(running | {name: {"ended": one} for name, one in ended.items()})
        return
    if found:
        terminal.console().print(tables.process_table(found))
    else:
        click.echo("no graph runs")
    for status in found:
        for why in tables.unreached(status):
            click.echo(why)
    for one in ended.values():
        click.echo(ended_line(one))


@click.command()
@click.argument("graph", required=False, type=RUNNING)
@click.option("--once", is_flag=True, help="Print one table and exit.")
@click.option("--every-s", default=1.0, type=INTERVAL_S, show_default=True)
@JSON
def top(graph: str | None, once: bool, every_s: float, as_json: bool) -> None:
    """Watch rates, latencies, drops, back-pressure, CPU and memory of a running graph."""
    client = clients.find(graph or "")
    looks = _looks(client, every_s)
    if once:
        looks = itertools.islice(looks, 1)
    if as_json:
        for now, before, seconds in looks:
            figures = live_figures(before, now, seconds)
            print_json({**msgspec.structs.asdict(now), "live": figures}, compact=not once)
        return
    console = terminal.console()
    found = (tables.top_tables(before, now, seconds) for now, before, seconds in looks)
    if once:
        console.print(*found)
        return
    if not console.is_terminal:  # a pipe: print one after the other
        for table in found:
            console.print(table)
        return
    with Live(console=console, auto_refresh=False, screen=True) as live:
        for table in found:
            live.update(cropped(table, console), refresh=True)


@click.command("health")
@click.argument("graph", required=False, type=RUNNING)
@JSON
def health_command(graph: str | None, as_json: bool) -> None:
    """Show the health of every node of one or all running graphs, on all hosts."""
    asked = {graph: clients.find(graph)} if graph else clients.graphs()
    if not asked:
        raise RunError("expected a running graph, got none")
    found = {name: client.health() for name, client in asked.items()}
    if as_json:
        plain = {
            graph: {node: health and fields_of(health) for node, health in nodes.items()}
            for graph, nodes in found.items()
        }
        print_json(plain)
    else:
        terminal.console().print(tables.health_table(found))
    mute = [f"{g}/{n}" for g, nodes in found.items() for n, h in nodes.items() if h is None]
    if mute:
        raise RunError(f"no answer from {', '.join(mute)}")


@click.command("schema")
@GRAPH
@NODE
@renamed_option("--graph", "`fovea schema GRAPH NODE`")
@click.option("--json", is_flag=True, expose_value=False, help="The result is always JSON.")
def schema_command(graph: str, node: str) -> None:
    """Print inputs, outputs, settings and commands of a running node."""
    print_json(fields_of(clients.find(graph).schema(node)))


@click.command()
@GRAPH
@click.argument("node", required=False)
@renamed_option("--graph", "`fovea logs GRAPH NODE`")
@click.option("--follow", "-f", is_flag=True)
@click.option("--lines", "-n", default=40, type=LINES, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def logs(graph: str, node: str | None, follow: bool, lines: int, as_json: bool) -> None:
    """Show a node's log, also after it has ended; without NODE, the output of a detached run."""
    if node is None and (follow or detached.noted(graph) is None):
        why = f"; {said}" if (said := clients.unknown(graph)) else ""
        words = f"expected `fovea logs GRAPH NODE`, got {harmless(graph)} alone"
        raise click.UsageError(f"{words}{why}")
    found = (
        detached.words(graph, lines)
        if node is None
        else clients.logs(graph, node, lines, follow=follow)
    )
    for line in found:
        if as_json:
            print_json({"graph": graph, "node": node, "line": line}, compact=True)
        else:
            click.echo(line)


@click.command()
@GRAPH
@OUTPUT
@renamed_option("--graph", "`fovea echo GRAPH NODE[.OUTPUT]`")
@click.option("--count", default=0, type=FRAMES_OR_NONE, help="Exit after this many.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def echo(graph: str, output: str, count: int, as_json: bool) -> None:
    """Print the messages of an output as they arrive."""
    for item in listening.echo(clients.find(graph).listen(output), count):
        if as_json:
            print_json(listening.plain(item), compact=True)
        else:
            click.echo(harmless(listening.line(item), MOST_LINE))


@click.command()
@GRAPH
@OUTPUT
@renamed_option("--graph", "`fovea hz GRAPH NODE[.OUTPUT]`")
@click.option("--duration-s", default=5.0, type=INTERVAL_S, show_default=True)
@JSON
def hz(graph: str, output: str, duration_s: float, as_json: bool) -> None:
    """Measure rate, jitter and age of an output's messages."""
    found = listening.rate(clients.find(graph).listen(output), duration_s)
    if as_json:
        print_json(found)
    else:
        click.echo(listening.rate_line(found, duration_s))


def _looks(client: GraphClient, every_s: float) -> Iterator[tuple[Status, Status, float]]:
    """Yield former status, current status and seconds between, until the graph ends."""
    with client.watching() as look:
        before, at_s = look(), time.monotonic()
        time.sleep(min(every_s, 1.0))
        while True:
            try:
                now, now_s = look(), time.monotonic()
            except RunError:
                if client.runs():
                    raise
                return
            yield now, before, now_s - at_s
            before, at_s = now, now_s
            time.sleep(every_s)
