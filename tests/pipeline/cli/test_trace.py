"""`fovea trace`: spans of a running graph, as OpenTelemetry's collectors get them."""

import json
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.client.tracing import MOST_OPEN, Arrival, Exposure, Exposures, spans_of
from pipeline.errors import SettingsError
from pipeline.run.rundir import running
from tests.sample_graphs import LOSSLESS, until

pytest.importorskip("opentelemetry.sdk", reason="needs the trace extra")
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import (
    ExportTraceServiceRequest,
)

from pipeline.cli.tracing import collector

FOVEA = (sys.executable, "-m", "pipeline.entry")


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Run a graph; return its name."""
    path, name = tmp_path_factory.mktemp("trace") / "graph.yaml", f"trace-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{LOSSLESS}")
    subprocess.run([*FOVEA, "run", str(path), "--detach"], check=True, capture_output=True)
    yield name
    if name in running():
        psutil.Process(running()[name]["pid"]).kill()
        until(lambda: name not in running())


def fovea(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*FOVEA, *words], capture_output=True, text=True, timeout=60, check=False)


@contextmanager
def collecting(status: int = 200) -> Iterator[tuple[str, list[Any]]]:
    """Serve as a collector; yield its URL and what comes."""
    found: list[Any] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            request = ExportTraceServiceRequest.FromString(body)
            found.extend(
                span for resource in request.resource_spans
                for scope in resource.scope_spans for span in scope.spans
            )  # fmt: skip
            self.send_response(status)
            self.end_headers()

        def log_message(self, format: str, *values: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1/traces", found
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_span_for_each_output_of_an_exposure_reaches_a_file(graph: str, tmp_path: Path) -> None:
    file = tmp_path / "spans.jsonl"

    done = fovea("trace", graph, "--save", str(file), "--duration-s", "1.5")

    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    wholes = {row["context"]["span_id"]: row for row in rows if row["parent_id"] is None}
    parts = [row for row in rows if row["parent_id"] is not None]
    assert len(wholes) > 5
    assert f"{len(rows)} spans of {len(wholes)} exposures" in done.stdout
    assert {row["name"] for row in parts} == {"ticker.context", "work"}
    for part in parts:
        whole = wholes[part["parent_id"]]
        assert part["attributes"]["fovea.seq"] == whole["attributes"]["fovea.seq"]
        assert whole["start_time"] <= part["start_time"] <= part["end_time"] <= whole["end_time"]


def test_a_collector_gets_them_as_protobuf_and_every_third_if_asked(graph: str) -> None:
    with collecting() as (url, found):
        done = fovea("trace", graph, "--otlp", url, "--duration-s", "1", "--every", "3")

    assert done.returncode == 0, done.stderr
    seqs = {
        value.value.int_value for span in found
        for value in span.attributes if value.key == "fovea.seq"
    }  # fmt: skip
    assert seqs
    assert all(seq % 3 == 0 for seq in seqs)


def test_what_a_collector_does_not_take_is_counted_and_the_graph_goes_on(graph: str) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{probe.getsockname()[1]}/v1/traces"
    with collecting(status=400) as (refuses, _found):
        for url in (nobody, refuses):
            done = fovea("trace", graph, "--otlp", url, "--duration-s", "0.5")
            assert done.returncode == 1
            assert "spans were not taken: the collector does not answer, or" in done.stderr

    assert graph in running()


def test_wrong_words_are_refused_in_one_sentence(graph: str, tmp_path: Path) -> None:
    (tmp_path / "there").write_text("kept")
    for words, status, said in (
        ((), 2, "expected --otlp URL or --save FILE, one of the two"),
        (("--save", str(tmp_path / "there")), 1, "there: cannot be written: File exists"),
        (("--save", str(tmp_path / "no" / "file")), 1, "No such file or directory"),
    ):
        done = fovea("trace", graph, *words)
        assert done.returncode == status
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    assert (tmp_path / "there").read_text() == "kept"


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("nowhere", "expected http"),
        ("ftp://127.0.0.1/x", "expected http"),
        ("http://[::1", "expected http"),
        ("http://127.0.0.1:99999/v1", "expected http"),
        ("http://10.0.0.1:4318/v1/traces", "expected https beyond this host"),
    ],
)
def test_an_unfit_address_of_a_collector_is_refused(url: str, said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        collector(url)


OUTPUTS = ("eye.out", "see.out", "aim.out")
INPUTS = {"see.out": ("eye.out",), "aim.out": ("see.out", "eye.out")}
ARRIVALS = st.lists(
    st.tuples(st.sampled_from(OUTPUTS), st.integers(0, 5), st.integers(100, 200)), max_size=60
)


@given(arrivals=ARRIVALS)
def test_spans_lie_within_their_exposure_whatever_the_order(
    arrivals: list[tuple[str, int, int]],
) -> None:
    exposures = Exposures(OUTPUTS)
    for output, seq, at_ns in arrivals:
        exposures.add(output, "a", seq, Arrival(at_ns, False, False), 50 if seq else None)

    for exposure in exposures.ended(0, all_of_them=True):
        whole, *parts = spans_of(exposure, INPUTS)
        assert {part.name for part in parts} == {o for o, s, _ in arrivals if s == exposure.seq}
        assert all(whole.begin_ns <= part.begin_ns <= part.end_ns <= whole.end_ns for part in parts)


def test_a_command_heard_before_its_inputs_begins_at_the_last_output_before() -> None:
    heard = {"eye.out": 30, "aim.out": 60, "see.out": 61}
    outputs = {name: Arrival(at_ns, False, False) for name, at_ns in heard.items()}
    chain = {"see.out": ("eye.out",), "aim.out": ("see.out",)}

    spans = {s.name: s for s in spans_of(Exposure("a", 1, 10, 30, outputs), chain)}

    assert (spans["aim.out"].begin_ns, spans["aim.out"].end_ns) == (30, 60)
    assert (spans["see.out"].begin_ns, spans["see.out"].end_ns) == (30, 61)


def test_exposures_end_complete_late_or_when_too_many_are_open() -> None:
    exposures = Exposures(OUTPUTS, wait_s=1.0)

    def add(output: str, seq: int, at_ns: int = 0) -> None:
        exposures.add(output, "a", seq, Arrival(at_ns, False, False), 0)

    for output in OUTPUTS:
        add(output, 0)
    add("eye.out", 1)
    assert [one.seq for one in exposures.ended(10)] == [0]
    assert [one.seq for one in exposures.ended(2_000_000_000)] == [1]
    add("see.out", 1)
    assert exposures.late == 1
    for seq in range(2, MOST_OPEN + 5):
        add("eye.out", seq)
    assert [one.seq for one in exposures.ended(10)] == [2, 3, 4]


def test_what_was_exposed_before_all_taps_listened_is_left_out() -> None:
    exposures = Exposures(OUTPUTS, since_ns=100)

    exposures.add("eye.out", "a", 1, Arrival(120, False, False), 90)
    exposures.add("eye.out", "a", 2, Arrival(130, False, False), 110)

    assert [one.seq for one in exposures.ended(0, all_of_them=True)] == [2]
