"""An end that a node did not announce is a crash, whatever its status; so is any exception."""

import json
import logging
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.errors import RunError
from pipeline.run.report import Report
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import apart, assert_accounts_add_up, go, plan_of
from tests.unruly_graphs import (
    UNRULY,
    all_recover,
    name_of,
    unruly_file,
    unruly_parts,
    unruly_plan,
)

FOVEA = (sys.executable, "-m", "pipeline.entry")
SAMPLES = Path(__file__).parents[2] / "faulty_samples.py"
WITHOUT_EXCEPTION = ("exit_0", "segfault")

KINDS = {
    "exit_0": "",
    "system_exit": "it exits: 0",
    "keyboard_interrupt": "KeyboardInterrupt",
    "group": "BaseExceptionGroup: both (2 sub-exceptions)",
    "thread": "ValueError: in a thread",
    "mute": "Mute: (its text cannot be had: RuntimeError)",
    "exit_in_open": "it exits: 0",
    "exit_in_headline": "it exits: 0",
    "close_streams": "ValueError: after it closed everything",
    "segfault": "ended by signal SIGSEGV",
}


@dataclass(frozen=True)
class Left:
    """The outcome of a graph whose parts all end unexpectedly, each in its own way."""

    name: str
    report: Report
    log: str


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Left:
    """Run a graph once for all kinds, until each part is restarted and frames pass it."""
    folder = tmp_path_factory.mktemp("left")
    plan = plan_of(folder, unruly_parts(folder, {kind: kind for kind in KINDS}))

    with Words() as words:
        report = go(plan, 0, lambda supervisor: all_recover(supervisor, KINDS))
    return Left(plan.name, report, "\n".join(words.lines))


class Words(logging.Handler):
    """Keeps everything that is logged meanwhile: `caplog` exists for one test only."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())

    def __enter__(self) -> "Words":
        logging.getLogger().addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        logging.getLogger().removeHandler(self)


@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_ends_unexpectedly_is_restarted(left: Left, kind: str) -> None:
    lines = [line for line in left.log.splitlines() if line.startswith((f"{kind}: ", f"{kind} "))]
    ending = "signal SIGSEGV" if kind == "segfault" else "exit status"

    assert left.report["failure"] == ""
    assert left.report["restarts"][kind] == 1
    assert left.report["crashes"][kind] == 1
    assert KINDS[kind] in "\n".join(lines)
    assert (f"{kind}: {SAMPLES}:" in left.log) == (kind not in WITHOUT_EXCEPTION)
    assert f"{kind} ended by {ending}" in left.log
    assert_accounts_add_up(left.report)


def test_an_exit_status_of_0_that_was_not_announced_is_told_as_such(left: Left) -> None:
    said = "exit_0 ended by exit status 0, which it did not announce"

    assert f"{said}, see `fovea logs {left.name} exit_0`" in left.log


def test_an_unexpected_end_of_a_part_that_may_not_restart_is_a_crash_in_the_report(
    tmp_path: Path,
) -> None:
    text = UNRULY.replace("restart: {backoff_s: 0.01}", "restart: never")

    report = go(unruly_plan(tmp_path, text=text, kind="exit_0"), 30)

    assert (report["failure"], report["restarts"]) == ("", {})
    assert report["crashes"] == {"unruly": 1}
    (found,) = (f for f in report["verdict"] if f["about"] == "processes")
    assert (found["held"], found["sentence"]) == (False, "1 process crashed: unruly once")


def test_a_part_that_crashes_in_an_extension_module_has_its_stack_in_the_log(left: Left) -> None:
    log = (base() / left.name / "segfault.log").read_text()

    assert "Fatal Python error: Segmentation fault" in log
    assert "in do_segfault" in log


def test_a_run_without_a_crash_reports_none(tmp_path: Path) -> None:
    report = go(unruly_plan(tmp_path), 10)

    assert report["crashes"] == {}
    assert not [f for f in report["verdict"] if f["about"] == "processes"]


@pytest.mark.parametrize("restart", ["{backoff_s: 0.01}", "never"])
def test_a_run_that_came_to_its_end_although_a_part_crashed_exits_with_3(
    tmp_path: Path, restart: str
) -> None:
    text = UNRULY.replace("{backoff_s: 0.01}", restart)
    once, path = tmp_path / "once", tmp_path / "report.json"
    graph = unruly_file(tmp_path, text=text, kind="exit_0", once=once)

    done = subprocess.run(
        [*FOVEA, "run", str(graph), "--frames", "30", "--report", str(path)],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip

    assert done.returncode == 3, done.stderr
    assert done.stderr.endswith(
        f"Error: {name_of(graph)} ran to its end, but 1 process crashed: unruly once\n"
    )
    assert "processes: 1 process crashed: unruly once" in done.stdout
    assert json.loads(path.read_text())["crashes"] == {"unruly": 1}


@pytest.mark.parametrize("kind", ["exit_in_open", "raise_in_open", "die_in_open"])
def test_a_part_that_cannot_open_and_may_not_restart_ends_the_run_with_a_sentence(
    tmp_path: Path, kind: str
) -> None:
    text = UNRULY.replace("restart: {backoff_s: 0.01}", "restart: never\n    start_s: 3000")
    graph = unruly_file(tmp_path, text=text, kind=kind)
    how = {
        "exit_in_open": ("exit status 1", "it exits: 0"),
        "raise_in_open": ("exit status 1", "ValueError: cannot open"),
        "die_in_open": ("signal SIGKILL", ""),
    }
    ending, why = how[kind]

    done = subprocess.run(
        [*FOVEA, "run", str(graph)], capture_output=True, text=True, check=False, timeout=100
    )

    assert done.returncode == 1
    said = f"fovea: unruly ended by {ending} before the graph ran, and may not start again"
    place = f": {re.escape(str(SAMPLES))}:[0-9]+: " if why else ""
    assert re.fullmatch(re.escape(said) + place + why, done.stderr.splitlines()[-1])


def test_in_lockstep_an_exit_with_status_0_ends_the_run_with_an_error(tmp_path: Path) -> None:
    report = go(unruly_plan(tmp_path, kind="exit_0", clock="lockstep"), 50)

    assert report["failure"] == (
        "unruly ended by exit status 0, which it did not announce: a lockstep run cannot go on"
    )


def test_the_end_of_a_source_that_may_not_restart_is_the_reason_for_the_end(
    tmp_path: Path,
) -> None:
    text = apart(UNRULY).replace("  ticker:\n", "  ticker:\n    restart: never\n")
    text = text.replace("tests.samples:Ticker", "tests.faulty_samples:Deserter")

    report = go(unruly_plan(tmp_path, text=text), 0)

    assert report["failure"] == (
        "ticker ended by exit status 0, which it did not announce: no source is left"
    )


@pytest.mark.parametrize("kind", ["exit_in_close", "exit_in_summary"])
def test_an_exit_of_a_part_while_it_is_stopped_is_reported_and_loses_no_frame(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    report = go(unruly_plan(tmp_path, kind=kind), 20)

    said = {
        "exit_in_close": "unruly: ended by exit status 0 while it was stopped",
        "exit_in_summary": "it exits: 0",
    }
    assert said[kind] in caplog.text
    assert report["failure"] == ""
    assert report["crashes"] == {"unruly": 1}
    assert report["summaries"]["after"]["seen"] == list(range(20))


def test_a_part_that_does_not_close_in_time_is_named_and_its_log_has_the_stack(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plan = unruly_plan(tmp_path, kind="hang_in_close")

    report = go(plan, 5)

    (said,) = [message for message in caplog.messages if message.startswith("unruly")]
    assert said == (
        "unruly: did not end within 3 s: it did not close; its device may still be open, "
        f"see `fovea logs {plan.name} unruly`"
    )
    assert "in close" in (base() / plan.name / "unruly.log").read_text()
    assert report["summaries"]["after"]["seen"] == list(range(5))


def test_a_part_that_ends_repeatedly_in_its_first_open_ends_the_start(
    tmp_path: Path,
) -> None:
    text = UNRULY.replace("backoff_s: 0.01", "backoff_s: 0.01, most: 1")
    plan = unruly_plan(tmp_path, text=text, kind="exit_in_open")

    with Supervisor(plan) as supervisor, pytest.raises(RunError, match="unruly died 2 times"):
        supervisor.start()


def test_output_of_a_part_that_closed_its_streams_goes_nowhere_but_to_its_log(left: Left) -> None:
    log = (base() / left.name / "close_streams.log").read_text()

    assert "into nothing" in log
    assert "after it closed everything" in log
    assert left.report["summaries"]["after_close_streams"]["torn"] == 0
