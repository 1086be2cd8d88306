"""`fovea metrics`: figures of a running graph, as Prometheus reads them."""

import json
import re
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from http.client import SERVICE_UNAVAILABLE
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode
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
from tests.sample_graphs import CHAIN, LOOP, together

FOVEA = (sys.executable, "-m", "pipeline.entry")
WAIT_S = 30.0
BUSY = f"""{LOOP}  slow:
    operator: tests.samples:Pass
    inputs: {{frame: ticker.context}}
    settings: {{sleep_s: 0.1}}
"""  # a loop, and a reader that drops


@pytest.fixture
def text() -> str:
    """The nodes of the graph."""
    return together(CHAIN, "ticker", "count", "glance")


@pytest.fixture
def graph(tmp_path: Path, text: str) -> Iterator[str]:
    """Run a graph; return its name."""
    path, name = tmp_path / "graph.yaml", f"metrics-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{text}")
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


@pytest.mark.skipif(not shutil.which("prometheus"), reason="needs prometheus")
@pytest.mark.parametrize("text", [together(BUSY, "ticker", "work", "pair", "steer")])
def test_prometheus_scrapes_a_run_and_every_panel_of_the_dashboard_has_data(
    graph: str, port: int, tmp_path: Path
) -> None:
    own_port = port + 1 if port < 65535 else port - 1
    config = tmp_path / "prometheus.yml"
    jobs = f"[{{job_name: fovea, static_configs: [{{targets: ['127.0.0.1:{port}']}}]}}]"
    config.write_text(f"global: {{scrape_interval: 1s}}\nscrape_configs: {jobs}\n")
    server = serving(graph, port)
    prometheus = subprocess.Popen(
        ["prometheus", f"--config.file={config}", f"--storage.tsdb.path={tmp_path / 'data'}",
         f"--web.listen-address=127.0.0.1:{own_port}"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        handled = f'rate(fovea_node_messages_handled_total{{graph="{graph}",node="work"}}[10s])'
        rates = answered(own_port, handled)
        empty = [query for query in queries(graph) if not answered(own_port, query)]
        (chosen,) = [v for v in dashboard()["templating"]["list"] if v["name"] == "graph"]
        metric = re.fullmatch(r"label_values\((\w+), graph\)", chosen["query"])
        assert metric is not None

        assert float(rates[0]["value"][1]) > 0
        assert empty == []
        assert graph in [found["metric"]["graph"] for found in answered(own_port, metric[1])]
    finally:
        for process in (prometheus, server):
            process.send_signal(signal.SIGINT)
        server.communicate(timeout=30)
        prometheus.wait(timeout=30)


def queries(graph: str) -> list[str]:
    """Return what the dashboard asks, of one graph."""
    panels = dashboard()["panels"]
    asked = [target["expr"] for panel in panels for target in panel.get("targets", ())]
    return [re.sub(r"\$graph", graph, one).replace("$__rate_interval", "10s") for one in asked]


def answered(port: int, query: str) -> list[Any]:
    """Ask Prometheus until it has an answer, or for some seconds; raises for a wrong query."""
    end_s, found = time.monotonic() + WAIT_S, list[Any]()
    while not found and time.monotonic() < end_s:
        time.sleep(0.2)
        address = f"http://127.0.0.1:{port}/api/v1/query?{urlencode({'query': query})}"
        try:
            with urlopen(address, timeout=10) as answer:
                found = json.load(answer)["data"]["result"]
        except HTTPError as error:
            if error.code != SERVICE_UNAVAILABLE:
                raise
        except URLError:
            continue  # it starts
    return found


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


def test_grafanas_own_models_know_every_word_of_the_dashboard() -> None:
    models = pytest.importorskip("grafana_foundation_sdk.models.dashboard", reason="needs the sdk")
    from grafana_foundation_sdk.cog.encoder import JSONEncoder
    from grafana_foundation_sdk.cog.plugins import register_default_plugins

    register_default_plugins()
    written = json.loads(json.dumps(dashboard()))
    misspelt = json.loads(json.dumps(written).replace("legendFormat", "legendFromat"))

    def lost(given: Any) -> list[str]:
        read = models.Dashboard.from_json(given)
        return list(differences(given, json.loads(JSONEncoder().encode(read))))

    assert lost(written) == []
    assert len(lost(misspelt)) == len(written["panels"])


def differences(given: Any, read: Any, at: str = "") -> Iterator[str]:
    """Yield the places of what is in the one and not in the other, which may have more."""
    if isinstance(given, dict) and isinstance(read, dict):
        for key, value in given.items():
            yield from differences(value, read.get(key), f"{at}.{key}")
    elif isinstance(given, list) and isinstance(read, list) and len(given) == len(read):
        for k, (one, other) in enumerate(zip(given, read, strict=True)):
            yield from differences(one, other, f"{at}[{k}]")
    elif given != read:
        yield at


def test_counters_and_units_are_named_as_prometheus_asks() -> None:
    assert not any(name.endswith("_total") for name in (*GAUGES, *COUNTERS))  # the library adds it
    assert not any(re.search(r"_(ms|mb|percent)$", name) for name in (*GAUGES, *COUNTERS))
