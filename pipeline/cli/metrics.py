"""`fovea metrics`: figures of running graphs over HTTP, for Prometheus."""

import ipaddress
import json
import threading
from pathlib import Path

import click

from pipeline import signals
from pipeline.cli.arguments import RUNNING
from pipeline.cli.dashboard import dashboard
from pipeline.client import find as clients
from pipeline.errors import RunError, SettingsError
from pipeline.extras import need

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
LOOK_S = 0.2


@click.command()
@click.argument("graph", required=False, type=RUNNING)
@click.option("--port", default=9464, show_default=True, type=click.IntRange(1, 65535))
@click.option("--listen", default="127.0.0.1", show_default=True, help="Address of this host.")
@click.option("--certificate", type=FILE, help="PEM; beyond this host TLS is required.")
@click.option("--key", type=FILE, help="PEM, of the certificate.")
@click.option("--clients", "authority", type=FILE, help="PEM: who signed those who may ask.")
@click.option("--dashboard", "wanted", is_flag=True, help="Print a Grafana dashboard and exit.")
def metrics(
    graph: str | None, port: int, listen: str, certificate: Path | None, key: Path | None,
    authority: Path | None, wanted: bool,
) -> None:  # fmt: skip
    """Serve figures of running graphs to Prometheus, until Ctrl-C; of all, if none is named."""
    if wanted:
        click.echo(json.dumps(dashboard(), indent=1))
        return
    need("prometheus_client", "fovea metrics")
    from prometheus_client import CollectorRegistry, start_http_server

    from pipeline.client.metrics import GraphMetrics

    check(listen, certificate, key, authority)
    if graph:
        client = clients.find(graph)  # a graph that does not run is an error now
        collector = GraphMetrics(lambda: [client.status()])
    else:
        collector = GraphMetrics(clients.statuses)
    registry = CollectorRegistry()
    registry.register(collector)
    tls = {
        "certfile": str(certificate), "keyfile": str(key), "client_cafile": str(authority),
        "client_auth_required": True,
    } if certificate else {}  # fmt: skip
    try:
        server, _thread = start_http_server(port, addr=listen, registry=registry, **tls)  # type: ignore[arg-type]
    except OSError as error:
        raise RunError(f"fovea metrics: {listen}:{port}: {error.strerror}") from error
    scheme = "https" if certificate else "http"
    click.echo(f"{graph or 'all graphs'}: {scheme}://{listen}:{port}/metrics; Ctrl-C ends it")
    over = threading.Event()
    with signals.Interruption() as asked:
        while not asked.asked():
            over.wait(LOOK_S)
    server.shutdown()


def check(listen: str, *files: Path | None) -> None:
    """Raise `SettingsError` for an address beyond this host without TLS and an access list."""
    try:
        address = ipaddress.ip_address(listen)
    except ValueError as error:
        raise SettingsError(f"--listen: expected an IP address, got {listen[:100]!r}") from error
    if any(files) and not all(files):
        raise SettingsError("expected --certificate, --key and --clients together, got some")
    if not address.is_loopback and not all(files):
        raise SettingsError(
            f"--listen {listen}: others reach it there; expected --certificate, --key and --clients"
        )
