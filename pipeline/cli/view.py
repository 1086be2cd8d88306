"""`fovea view`: watch a running graph in a browser."""

import os
import signal
import socket
import sys
from contextlib import ExitStack, suppress
from urllib.parse import quote

import click

from pipeline import signals
from pipeline.cli.arguments import RUNNING
from pipeline.client import find as clients
from pipeline.client.graph_client import GraphClient
from pipeline.client.viewing import attached, follow
from pipeline.errors import RunError

PORT = click.IntRange(0, 65535)
JOIN_S = 10.0  # for the viewer to join, after Ctrl-C
USUAL = {"port": 9876, "web_port": 9090}  # Rerun's own


@click.command()
@click.argument("graph", required=False, type=RUNNING)
@click.option("--port", default=0, type=PORT, help="Of the data; 0: 9876, or any free one.")
@click.option("--web-port", default=0, type=PORT, help="Of the page; 0: 9090, or any free one.")
@click.option("--every", default=1, type=click.IntRange(1), help="Show each n-th frame.")
@click.option("--details", is_flag=True, help="Show series of each stage and object, too.")
@click.option("--no-browser", is_flag=True, help="Print the address only.")
def view(
    graph: str | None, port: int, web_port: int, every: int, details: bool, no_browser: bool
) -> None:
    """Watch a running graph in a browser of this host, with Rerun; Ctrl-C ends the view only."""
    client = clients.find(graph or "")
    used: dict[str, int] = {}

    def settings() -> dict[str, object]:
        used["port"] = port or _free("port", ())
        used["web_port"] = web_port or _free("web_port", (used["port"],))
        return {"serve": True, **used, "every": every, "details": details}

    node = ""
    with ExitStack() as viewer:
        # a command that left while the viewer joins would leave it behind
        with signals.Interruption() as asked, asked.giving_up(JOIN_S):
            node = viewer.enter_context(attached(client, settings))
        if asked.asked():
            over = f"{client.name}: goes on without the view"
        else:
            over = _watched(client, node, used, browser=not no_browser)
    click.echo(over)
    if asked.status and asked.number != signal.SIGINT:
        sys.exit(asked.status)


def _watched(client: GraphClient, node: str, used: dict[str, int], *, browser: bool) -> str:
    """Print the address, and watch until Ctrl-C or an end; return why, as a sentence."""
    data = quote(f"rerun+http://127.0.0.1:{used['port']}/proxy", safe="")
    address = f"http://127.0.0.1:{used['web_port']}/?url={data}"
    try:
        click.echo(f"{client.name}: look at {address}\nCtrl-C ends the view; the graph goes on")
        if browser:
            _launch(address)
        return follow(client, node)
    except KeyboardInterrupt:
        return f"{client.name}: goes on without the view"


def _launch(address: str) -> None:
    """Open a browser where there is one: the address is printed in any case.

    What opens it may run on: nothing waits for it, and its own complaints are not shown.
    """
    silent = [(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_RDWR, 0) for fd in range(3)]
    with suppress(OSError):  # no xdg-open
        os.posix_spawnp("xdg-open", ["xdg-open", address], os.environ, file_actions=silent)


def _free(name: str, taken: tuple[int, ...]) -> int:
    """Return Rerun's usual port if it is free, else any free one."""
    for port in (USUAL[name], 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            found = int(probe.getsockname()[1])
            if found not in taken:
                return found
    raise RunError(f"visualise.{name}: expected a free port, got none")
