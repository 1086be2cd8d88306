"""Output stays readable in terminals of 50 and 30 columns, without colours and in pipes."""

import fcntl
import itertools
import os
import pty
import secrets
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console, RenderableType

from pipeline.bus.ledger import private_ledger
from pipeline.cli.tables import health_table, process_table, top_tables
from pipeline.client.find import find
from pipeline.client.graph_client import Status
from pipeline.graph.loader import load
from pipeline.protocol.fleet import EdgeState, NodeState, Process, State
from pipeline.protocol.questions import Health
from pipeline.run.report import compose, print_report, tables
from pipeline.run.rundir import running
from tests.sample_graphs import CHAIN, together

ROOT = Path(__file__).resolve().parents[3]
FOVEA = (sys.executable, "-m", "pipeline.entry")
NAMES = ("capture", "association", "roi_features")
TIMES = {"count": 9, "mean": 12.5, "p50": 12.5, "p99": 412.0, "max": 412.0}
ACCOUNT = {
    "offered": 54_000, "delivered": 53_990, "dropped": {"superseded": 10}, "lost_in_crash": 0,
    "in_flight": 0,
}  # fmt: skip


def status() -> Status:
    """Return the status of a graph with the longest names and figures."""
    state = State(
        graph="tracking", label="", at_ns=0, phase="running", failure="", hosts=(),
        network_bytes={},
        processes=tuple(Process(name, (name,), 4_194_303, 3600.5, 1500.0, 3, 4) for name in NAMES),
        nodes=tuple(
            NodeState(
                name=name, condition="waiting", epoch=12, handled=54_000, last_seq=54_000,
                handler_ms=TIMES, hop_ms=TIMES, loop_ms=TIMES,
            ) for name in NAMES
        ),
        edges=tuple(
            EdgeState(
                origin=name, end=f"{name}.schedule", account=ACCOUNT, age_ms=TIMES,
                age_error_ms=0.0, broken=False, sent=54_000,
            ) for name in NAMES
        ),
    )  # fmt: skip
    return Status(graph="tracking", hosts={"": (state,)}, nodes=dict.fromkeys(NAMES, ""))


def health() -> Health:
    return Health(
        node="capture", process="capture", host="", state="waiting", problem="", broken=(),
        pid=4_194_303, epoch=12, last_seq=54_000, own_mb=1500.0, handled=54_000, busy_s=0.0,
        silent_s=0.0, words="", waiting={}, dropped={},
    )  # fmt: skip


def report() -> RenderableType:
    plan = load(ROOT / "graphs" / "tracking.yaml")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    for account in ledger.edges:
        account.sent = account.delivered = 54_000
    return tables(compose(plan, ledger, {}, {}, duration_s=1.0))


SHOWN = {
    "ps": lambda: (process_table([status()]), {"tracking"}),
    "top": lambda: (top_tables(status(), status(), 1.0), set(NAMES)),
    "health": lambda: (health_table({"tracking": dict.fromkeys(NAMES, health())}), {"tracking"}),
    "run --verbose": lambda: (report(), {"capture.context", "roi_features", "policy"}),
}


def lines_of(shown: RenderableType, width: int) -> list[str]:
    console = Console(width=width)
    with console.capture() as caught:
        console.print(shown)
    return caught.get().splitlines()


def headings(lines: list[str]) -> list[str]:
    """Return the lines above the rules of tables."""
    return [above for above, line in itertools.pairwise(lines) if line.startswith("──")]


@pytest.mark.parametrize("width", [50, 30])
@pytest.mark.parametrize("what", SHOWN)
def test_names_and_headings_stay_whole_and_what_is_left_out_is_named(what: str, width: int) -> None:
    shown, names = SHOWN[what]()
    wide = [word for line in headings(lines_of(shown, 300)) for word in line.split()]

    lines = lines_of(shown, width)

    kept = [word for line in headings(lines) for word in line.split()]
    text = " ".join(" ".join(lines).split())
    assert max(map(len, lines)) <= width
    assert "too narrow for: " in text
    assert [word for word in kept if word not in wide] == []
    assert [word for word in wide if word not in kept and word not in text] == []
    assert {line.split()[0] for line in lines if line.split()} >= names


@pytest.mark.parametrize("width", [50, 30])
def test_the_verdict_of_a_run_is_read_in_a_narrow_terminal(width: int) -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    console = Console(width=width, force_terminal=True, color_system=None)

    with console.capture() as caught:
        print_report(console, compose(plan, ledger, {}, {}, duration_s=1.0))

    lines = caught.get().splitlines()
    assert max(map(len, lines)) <= width
    assert {"rate", "loop", "losses"} <= {line.split()[0] for line in lines if line.split()}
    assert "no frame was made" in " ".join(caught.get().split())


def in_terminal(*words: str, columns: int = 50, **environment: str) -> tuple[int, str]:
    """Run a command in a terminal of so many columns; return its exit status and output."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    known = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "COLUMNS", "LINES")}
    with subprocess.Popen(
        [*FOVEA, *words], stdin=its, stdout=its, stderr=its, start_new_session=True,
        env={**known, "TERM": "xterm-256color", **environment},
    ) as process:  # fmt: skip
        os.close(its)
        shown = b""
        try:
            while chunk := os.read(ours, 65_536):
                shown += chunk
        except OSError:  # the other end is closed
            pass
        finally:
            os.close(ours)
    return process.returncode, shown.decode()


@pytest.fixture(scope="module")
def name(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = tmp_path_factory.mktemp("graph") / "graph.yaml"
    name = f"narrow-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{together(CHAIN, 'ticker', 'glance')}")
    begun = subprocess.run([*FOVEA, "run", str(path), "--detach"], check=False, timeout=120)
    assert begun.returncode == 0
    yield name
    if name in running():
        find(name).stop()


@pytest.mark.parametrize("words", ["top GRAPH --once", "health GRAPH", "set GRAPH count", "ps"])
def test_a_terminal_has_colours_unless_they_are_not_wanted(name: str, words: str) -> None:
    command = words.replace("GRAPH", name).split()

    coloured, plain = in_terminal(*command), in_terminal(*command, NO_COLOR="1")

    assert (coloured[0], plain[0]) == (0, 0), coloured[1] + plain[1]
    assert "\x1b[" in coloured[1]
    assert "\x1b" not in plain[1]
    # the end of another test's graph is shown as a sentence, which the terminal wraps
    lines = [line for line in plain[1].splitlines() if ": ended " not in line]
    assert {len(line) > 50 for line in lines} == {False}


@pytest.mark.parametrize(
    "words",
    [
        ("run", "tracking", "--inline", "--frames", "1", "--verbose"),
        ("run", "GRAPH.yaml", "--frames", "5"),
        ("run", "GRAPH.yaml", "--frames", "9", "--set", "count.sleep_s=-1"),
        ("check", "tracking"),
        ("weights", "list"),
        ("doctor",),
        ("rum",),
        ("run", "--help"),
    ],
)
def test_nothing_writes_an_escape_sequence_where_no_colours_are_wanted(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "GRAPH.yaml"
    path.write_text(f"name: plain-{secrets.token_hex(3)}\n{together(CHAIN, 'ticker', 'glance')}")

    _, shown = in_terminal(*(w.replace("GRAPH.yaml", str(path)) for w in words), NO_COLOR="1")

    assert shown.strip()
    assert "\x1b" not in shown


def test_top_in_a_pipe_prints_one_table_after_the_other(name: str) -> None:
    command = [*FOVEA, "top", name, "--every-s", "0.1"]

    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as top:
        assert top.stdout is not None
        try:
            titles = 0
            while titles < 2:
                line = top.stdout.readline()
                assert line, "top ended"
                assert "\x1b" not in line
                titles += line.startswith("edges, p50")
        finally:
            top.terminate()


def test_echo_ends_without_an_error_when_its_reader_ends(name: str) -> None:
    with subprocess.Popen(
        [*FOVEA, "echo", name, "glance"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as echo:
        assert echo.stdout is not None
        assert echo.stderr is not None
        assert echo.stdout.readline()
        echo.stdout.close()
        said = echo.stderr.read()

    assert said == ""
