"""`fovea draw`: a graph as Mermaid, SVG or lines of text, with live rates while it runs."""

import time
from pathlib import Path
from typing import Any

import click

from pipeline.cli.overlaid import GRAPH, load_overlaid, overlaid
from pipeline.client import find as clients
from pipeline.client.graph_client import GraphClient
from pipeline.graph.drawing import listing, mermaid
from pipeline.graph.picture import svg

FORMS = {"mermaid": mermaid, "svg": svg, "text": listing}
SPAN_S = 2.0  # over which rates are counted


@click.command()
@GRAPH
@overlaid
@click.option("--as", "form", type=click.Choice(list(FORMS)), default="mermaid", show_default=True)
@click.option("--text", is_flag=True, help="The same as --as text.")
@click.option("--live", is_flag=True, help="With rates and drops of the running graph.")
def draw(graph: Path, form: str, text: bool, live: bool, **laid: Any) -> None:
    """Print a graph as a Mermaid chart, SVG or lines: types, load policies, hosts."""
    plan = load_overlaid(graph, **laid)
    told = rates(clients.find(plan.name)) if live else None
    click.echo(FORMS["text" if text else form](plan, told))


def rates(client: GraphClient) -> dict[str, str]:
    """Return `node.input` -> messages a second over two seconds, and drops since the start."""
    before, began_s = _accounts(client), time.monotonic()
    time.sleep(SPAN_S)
    after, span_s = _accounts(client), time.monotonic() - began_s
    found = {}
    for end, account in after.items():
        delivered = account.get("delivered", 0) - before.get(end, {}).get("delivered", 0)
        dropped = sum(account.get("dropped", {}).values())
        lost = f", {dropped} dropped" if dropped else ""
        found[end] = f"{max(0, delivered) / span_s:.1f}/s{lost}"
    return found


def _accounts(client: GraphClient) -> dict[str, dict[str, Any]]:
    hosts = client.status().hosts.values()
    states = [state for told in hosts if not isinstance(told, str) for state in told]
    return {edge.end: edge.account for state in states for edge in state.edges}
