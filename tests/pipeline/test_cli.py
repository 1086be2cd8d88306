"""The commands as a user types them."""

import json
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from pipeline.cli import commands
from tests.commands import command
from tests.sample_graphs import LOOP, together, until

FOVEA = (sys.executable, "-m", "pipeline.cli")

NAP = """
import time
from pipeline import cli

@cli.commands.command()
def nap():
    try:
        print("asleep", flush=True)
        time.sleep(60)
    finally:
        print("awake", flush=True)

cli.main()
"""


def fovea(*words: str, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*FOVEA, *words], capture_output=True, text=True, timeout=timeout_s, check=False
    )


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: cli-{secrets.token_hex(3)}\n{together(LOOP, 'pair', 'steer')}")
    return path


@pytest.fixture
def name(graph: Path) -> str:
    return graph.read_text().splitlines()[0].split()[1]


@pytest.fixture
def running(graph: Path, name: str) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen(
        [*FOVEA, "run", str(graph)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        until(lambda: process.poll() is not None or not command("health", name).returncode)
        assert process.poll() is None, process.communicate()[0]
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


def test_a_run_prints_its_accounts_and_writes_its_report(graph: Path, tmp_path: Path) -> None:
    report = tmp_path / "deep" / "report.json"

    words = ("--clock", "lockstep", "--frames", "30", "--verbose", "--report", str(report))
    done = fovea("run", str(graph), *words)

    assert done.returncode == 0, done.stderr
    assert "edges: offered = delivered" in done.stdout
    assert "loop: no latency: in lockstep" in done.stdout
    found = json.loads(report.read_text())
    assert {"edges", "stages", "loop", "frames", "schedule_sha256", "verdict"} <= set(found)
    assert {"from", "to", "offered", "delivered", "dropped", "in_flight", "lost_in_crash"} <= set(
        found["edges"][0]
    )
    assert {"node", "latency_ms", "rate_hz", "cpu_percent", "rss_mb"} <= set(found["stages"][0])
    assert set(found["loop"]["latency_ms"]) == {"p50", "p99"}


def test_an_inline_run_gives_the_same_commands_as_a_lockstep_one(
    graph: Path, tmp_path: Path
) -> None:
    shas = []
    for words in (["--inline"], ["--clock", "lockstep"]):
        report = tmp_path / "report.json"
        done = fovea("run", str(graph), *words, "--frames", "20", "--report", str(report))
        assert done.returncode == 0, done.stderr
        shas.append(json.loads(report.read_text())["schedule_sha256"])

    assert shas[0] == shas[1]


def test_a_wrong_graph_exits_with_2_and_one_sentence(graph: Path) -> None:
    graph.write_text(graph.read_text().replace("frame: ticker.context", "frame: tiker.context"))

    done = command("run", str(graph))

    assert done.returncode == 2
    assert done.stderr.strip() == (
        f"fovea: {graph}:9: work.inputs.frame: no node tiker, did you mean 'ticker.context'?"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--frames", "5", "--duration-s", "5"], "give one of them"),
        (["--inline", "--clock", "realtime"], "runs in lockstep"),
        (["--set", "work.evry=2"], "did you mean 'every'"),
        (["--source", "nowhere.yaml"], "cannot be read"),
        (["--save", "x.rrd"], "needs a node with a setting `save`"),
        (["--with", "viewer"], "no node viewer"),
    ],
)
def test_wrong_options_exit_with_2_and_a_reason(graph: Path, words: list[str], said: str) -> None:
    done = command("run", str(graph), *words)

    assert done.returncode == 2
    assert said in done.stderr


def test_a_source_that_breaks_ends_the_run_with_one_sentence(graph: Path) -> None:
    done = fovea("run", str(graph), "--set", "ticker.fail_at=3")

    assert done.returncode != 0
    assert "picture 3: torn" in done.stderr


def test_check_draw_and_schema_start_nothing(graph: Path) -> None:
    assert "4 nodes in 3 processes" in " ".join(command("check", str(graph)).stdout.split())
    assert command("draw", str(graph)).stdout.startswith("flowchart LR")
    assert json.loads(command("check", "--schema").stdout)["title"] == "fovea graph"


@pytest.mark.lengthy
def test_a_running_graph_can_be_looked_at_and_ends_cleanly_on_ctrl_c(
    running: "subprocess.Popen[str]", name: str
) -> None:
    echoed = fovea("echo", name, "steer", "--count", "2")
    rate = command("hz", name, "ticker.roi", "--duration-s", "1")
    table = command("top", name, "--once")
    logs = command("logs", name, "work")
    unknown = command("echo", name, "stear")

    assert len(echoed.stdout.splitlines()) == 2, echoed.stderr
    assert "windows int32[4, 4]" in echoed.stdout
    assert float(rate.stdout.split(" Hz")[0].split()[-1]) > 0, rate.stdout
    assert "edges" in table.stdout
    assert logs.returncode == 0
    assert unknown.returncode == 1
    assert "did you mean 'steer'" in unknown.stderr
    running.send_signal(signal.SIGINT)
    out, _ = running.communicate(timeout=60)
    assert running.returncode == 128 + signal.SIGINT
    assert "losses: none of" in out or " messages on " in out
    assert "edges: offered = delivered" not in out
    assert name not in command("ps").stdout


def test_settings_of_a_running_node_change_or_are_refused_with_a_reason(
    running: "subprocess.Popen[str]", name: str
) -> None:
    done = command("set", name, "work", "every=2", "hold=1")
    shown = command("set", name, "work")
    refused = command("set", name, "work", "sleep_s=1")
    nowhere = command("set", "nowhere", "work", "every=2")
    wrong = command("set", name, "work", "every=2", "every")

    assert done.stdout.splitlines() == ["work.every = 2", "work.hold = 1"]
    assert done.returncode == 0
    assert [line for line in shown.stdout.splitlines() if "every" in line and "yes" in line]
    assert refused.returncode == 1
    assert refused.stderr.strip() == (
        "fovea: work.sleep_s: cannot change while the node runs; every, hold can"
    )
    assert (nowhere.returncode, wrong.returncode) == (1, 2)
    assert "no graph nowhere runs" in nowhere.stderr
    assert "every: expected NAME=VALUE" in wrong.stderr


def test_sigterm_ends_a_run_like_ctrl_c(running: "subprocess.Popen[str]") -> None:
    running.send_signal(signal.SIGTERM)
    out, _ = running.communicate(timeout=60)

    assert running.returncode == 128 + signal.SIGTERM
    assert "losses: " in out


def test_a_command_that_is_terminated_closes_what_it_opened() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", NAP, "nap"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        begun = process.stdout.readline()
        process.terminate()

        assert (begun, process.stdout.read()) == ("asleep\n", "awake\n")

    assert process.returncode == 128 + signal.SIGTERM


@pytest.mark.parametrize(("words", "levels"), [(["ps"], ["off"]), (["run", "none.yaml"], [])])
def test_the_transport_prints_nothing_between_the_lines_of_an_answer(
    words: list[str], levels: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr("zenoh.init_log_from_env_or", said.append)

    CliRunner().invoke(commands, words)

    assert said == levels


@pytest.mark.parametrize(
    ("command", "old", "new"),
    [
        (["doctor"], ["--sweep"], "--cleanup"),
        (["secure", "init"], ["--box", "a=10.0.0.1"], "--host"),
        (["secure", "add"], ["--box", "a=10.0.0.1"], "--host"),
        (["secure", "init"], ["--person", "alice"], "--user"),
        (["secure", "add"], ["--person", "alice"], "--user"),
        (["up"], ["--papers", "x"], "--credentials"),
        (["attach"], ["--papers", "x"], "--credentials"),
        (["export"], ["--papers", "x"], "--credentials"),
        (["export"], ["--person", "alice"], "--user"),
        (["logs", "work"], ["--graph", "g"], "`fovea logs GRAPH NODE`"),
        (["schema", "work"], ["--graph", "g"], "`fovea schema GRAPH NODE`"),
        (["echo", "work"], ["--graph", "g"], "`fovea echo GRAPH NODE[.OUTPUT]`"),
        (["hz", "work"], ["--graph", "g"], "`fovea hz GRAPH NODE[.OUTPUT]`"),
    ],
)
def test_an_option_that_was_renamed_names_the_new_one(
    command: list[str], old: list[str], new: str
) -> None:
    done = CliRunner().invoke(commands, [*command, *old])

    assert done.exit_code == 2
    assert f"{old[0]}: renamed; expected {new}" in done.output
    assert old[0] not in CliRunner().invoke(commands, [*command, "--help"]).output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["logs", "work"],
            "expected `fovea logs GRAPH NODE`, got work alone; no graph work runs or has run here",
        ),
        (["schema", "work"], "expected `fovea schema GRAPH NODE`, got work alone"),
        (["echo", "work.roi"], "expected `fovea echo GRAPH NODE[.OUTPUT]`, got work.roi alone"),
        (["hz", "work"], "expected `fovea hz GRAPH NODE[.OUTPUT]`, got work alone"),
        (["set", "g", "work.every=2"], "expected NODE SETTING=VALUE: fovea set g work every=2"),
        (["set", "g", "every=2"], "expected NODE SETTING=VALUE: fovea set g NODE every=2"),
    ],
)
def test_a_changed_order_of_arguments_names_the_new_one(words: list[str], said: str) -> None:
    done = CliRunner().invoke(commands, words)

    assert done.exit_code == 2
    assert said in done.output
