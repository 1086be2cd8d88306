"""`fovea metrics`: figures of a running graph, as Prometheus reads them."""

import json
import re
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest

pytest.importorskip("prometheus_client", reason="needs the metrics extra")
from prometheus_client.parser import text_string_to_metric_families

from pipeline.cli.dashboard import dashboard
from pipeline.cli.metrics import check
from pipeline.client.metrics import COUNTERS, GAUGES
from pipeline.errors import SettingsError
from pipeline.run.rundir import running
from tests.commands import command
from tests.sample_graphs import CHAIN, together

FOVEA = (sys.executable, "-m", "pipeline.entry")
WAIT_S = 30.0


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[str]:
    """Run a graph; return its name."""
    path, name = tmp_path / "graph.yaml", f"metrics-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{together(CHAIN, 'ticker', 'count', 'glance')}")
    subprocess.run([*FOVEA, "run", str(path), "--detach"], check=True, capture_output=True)
    yield name
    if name in running():
        psutil.Process(running()[name]["pid"]).kill()


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def scraped(port: int) -> dict[str, dict[frozenset[tuple[str, str]], float]]:
    """Samples by name and labels."""
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
        families = list(text_string_to_metric_families(answer.read().decode()))
    found: dict[str, dict[frozenset[tuple[str, str]], float]] = {}
    for family in families:
        for sample in family.samples:
            found.setdefault(sample.name, {})[frozenset(sample.labels.items())] = sample.value
    return found


def serving(graph: str, port: int) -> "subprocess.Popen[str]":
    """Start `fovea metrics` and wait until it listens."""
    server = subprocess.Popen(
        [*FOVEA, "metrics", graph, "--port", str(port)], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    assert f"http://127.0.0.1:{port}/metrics" in server.stdout.readline()
    return server


def test_a_scrape_has_what_the_graph_did_and_the_server_outlives_it(graph: str, port: int) -> None:
    server = serving(graph, port)
    try:
        end_s = time.monotonic() + WAIT_S
        handled = "fovea_node_messages_handled_total"
        own = frozenset({"graph": graph, "host": "", "node": "count"}.items())
        while not scraped(port).get(handled, {}).get(own) and time.monotonic() < end_s:
            time.sleep(0.1)
        first = scraped(port)
        time.sleep(1)
        later = scraped(port)

        assert later[handled][own] > first[handled][own] > 0
        assert later["fovea_graph_running"][frozenset({"graph": graph, "host": ""}.items())] == 1
        delivered = later["fovea_edge_messages_delivered_total"]
        assert any(dict(one)["from"].startswith("ticker") and n for one, n in delivered.items())
        memory = later["fovea_process_resident_memory_bytes"]
        assert all(10e6 < n < 1e9 for n in memory.values())

        assert command("stop", graph).returncode == 0
        time.sleep(1)
        assert handled not in scraped(port)
    finally:
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=30)


def test_a_port_that_is_taken_is_one_sentence(graph: str, port: int) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()

        done = command("metrics", graph, "--port", str(port))

    assert done.returncode == 1
    assert f"127.0.0.1:{port}: Address already in use" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("listen", "files", "said"),
    [
        ("0.0.0.0", (None, None, None), "expected --certificate, --key and --clients"),
        ("127.0.0.1", (Path("a"), None, None), "together, got some"),
        ("localhost/..", (None, None, None), "expected an IP address"),
    ],
)
def test_it_listens_beyond_this_host_only_with_tls_and_an_access_list(
    listen: str, files: tuple[Path | None, ...], said: str
) -> None:
    with pytest.raises(SettingsError, match=said):
        check(listen, *files)


def test_the_dashboard_asks_for_figures_that_exist() -> None:
    served = set(GAUGES) | {f"{name}_total" for name in COUNTERS}
    asked = re.findall(r"fovea_[a-z_]+", json.dumps(dashboard()))

    assert len(dashboard()["panels"]) >= 8
    assert set(asked) <= served


def test_counters_and_units_are_named_as_prometheus_asks() -> None:
    assert not any(name.endswith("_total") for name in (*GAUGES, *COUNTERS))  # the library adds it
    assert not any(re.search(r"_(ms|mb|percent)$", name) for name in (*GAUGES, *COUNTERS))
