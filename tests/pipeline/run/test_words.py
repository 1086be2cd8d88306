"""Texts from nodes are bounded and sanitised for readers; the nodes' logs have them whole."""

import json
import math
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.protocol.codec import MARKER, VERSION, encode
from pipeline.protocol.lines import as_line
from pipeline.protocol.orders import Result, StopOrder, SwapOrder
from pipeline.protocol.supervision import Event, Failed, Resumed, Uncut
from pipeline.run.channel import MOST_LINE, MOST_LINES_S, MOST_UNSENT, Channel, Exchange
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from pipeline.text import harmless, plain
from tests.sample_graphs import assert_accounts_add_up, go, handled, reasons, wait_for
from tests.unruly_graphs import name_of, recovers, unruly_file, unruly_plan

NEXT = Resumed("work")
FOVEA = (sys.executable, "-m", "pipeline.entry")


@given(st.text(st.characters(), max_size=60), st.integers(0, 50))
def test_harmless_text_is_short_printable_and_can_be_written(text: str, most: int) -> None:
    shown = harmless(text, most)

    shown.encode()
    assert not any(c < " " or c == "\x7f" for c in shown)
    assert len(shown) <= 10 * most + 30
    if text.isascii() and text.isprintable() and len(text) <= most:
        assert shown == text


@given(st.recursive(st.text(max_size=5), lambda x: st.lists(x) | st.dictionaries(st.text(), x)))
def test_harmless_figures_can_be_written(value: Any) -> None:
    json.dumps(plain(value), ensure_ascii=False).encode()


def test_figures_that_are_nested_too_deep_are_cut_off() -> None:
    deep: Any = []
    for _ in range(500):
        deep = [deep]

    assert "…" in json.dumps(plain(deep), ensure_ascii=False)


def test_a_long_exception_holds_nothing_up_and_its_log_has_it_whole(tmp_path: Path) -> None:
    size = 400_000  # Rich did not come to the end of a quarter of it
    graph = unruly_file(tmp_path, kind="long_text", size=size, once=tmp_path / "once")

    done = subprocess.run(
        [*FOVEA, "run", str(graph), "--frames", "60"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip

    assert done.returncode == 3, done.stderr  # it came to its end, with a crash
    said = "".join(done.stdout.split())
    assert "ValueError:xxxx" in said
    assert "charactersmore)" in said
    assert len(done.stdout) < 20_000
    assert len((base() / name_of(graph) / "unruly.log").read_text()) > size


def test_an_exception_text_drives_no_terminal_and_no_log_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plan = unruly_plan(tmp_path, kind="odd_text", once=tmp_path / "once")

    go(plan, 0, recovers)

    (said,) = [m for m in caplog.messages if "odd" in m]
    assert said.startswith("unruly: ")
    assert said.endswith(r": ValueError: odd \ud800\x1b[2J\x00\u202e text and more")


@pytest.mark.parametrize("size", [3_000, 3_000_000])
def test_a_headline_is_cut_to_a_line(tmp_path: Path, size: int) -> None:
    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: bool(supervisor.reports.headlines), 60)
        supervisor.finish()
        shown.append(supervisor.reports.headlines["unruly"])

    shown: list[str] = []
    report = go(unruly_plan(tmp_path, kind="huge_headline", size=size), 0, during)

    assert len(shown[0]) < 300
    assert shown[0].isprintable()
    assert report["failure"] == ""


def run_by_command(
    folder: Path, kind: str, **settings: object
) -> tuple[subprocess.CompletedProcess[str], dict[str, Any]]:
    """Run a graph with an unruly part for 20 frames; return what it printed, and its report."""
    graph, report = unruly_file(folder, kind=kind, **settings), folder / "r.json"
    done = subprocess.run(
        [*FOVEA, "run", str(graph), "--frames", "20", "--report", str(report)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done, json.loads(report.read_text())


@pytest.mark.parametrize(
    ("kind", "size"), [("long_summary", 50_000_000), ("huge_summary", 200_000)]
)
def test_a_huge_summary_is_left_out_and_the_report_has_the_reason(
    tmp_path: Path, kind: str, size: int
) -> None:
    done, found = run_by_command(tmp_path, kind, size=size)

    assert found["left_out"]["unruly"].startswith("expected up to 1048576 bytes, got 1")
    assert "unruly: its summary is incomplete: expected up to" in done.stdout
    assert found["frames"]["exposed"] == 20


def test_a_figure_that_is_no_plain_value_is_left_out_of_a_summary_with_the_reason(
    tmp_path: Path,
) -> None:
    done, found = run_by_command(tmp_path, "wrong_summary")

    why = "without wrong: Object of type object is not JSON serializable"
    assert found["left_out"] == {"unruly": why}
    assert f"unruly: its summary is incomplete: {why}" in done.stdout
    assert (found["kept"], found["round"], found["crashes"]) == (3, math.pi, {})


def test_a_summary_that_is_no_mapping_is_left_out_with_the_reason(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    report = go(unruly_plan(tmp_path, kind="no_summary"), 20)

    said = "unruly: its summary is incomplete: summary() returned NoneType, no mapping"
    assert said in caplog.messages
    assert report["crashes"] == {}


def test_a_long_text_in_a_summary_is_cut_with_the_number_of_missing_characters(
    tmp_path: Path,
) -> None:
    report = go(unruly_plan(tmp_path, kind="long_summary", size=2500), 20)

    assert report["long"] == "x" * 1000 + "… (1500 characters more)"
    assert "left_out" not in report


def test_a_summary_of_odd_figures_breaks_no_report(tmp_path: Path) -> None:
    done, found = run_by_command(tmp_path, "odd_summary")

    assert "Traceback" not in done.stdout + done.stderr
    assert "failure" not in found


def test_a_state_that_cannot_be_had_fails_only_the_swap(tmp_path: Path) -> None:
    answers: list[Result] = []

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "after") > 5, 60)
        order = SwapOrder(node="unruly", probation=5)
        supervisor.control.take(order, answers.append)
        wait_for(supervisor, lambda: bool(answers), 60)
        supervisor.finish()

    report = go(unruly_plan(tmp_path, kind="broken_state", size=100_000), 0, during)

    assert reasons(answers)[0].startswith("unruly: the running instance's state() failed: ")
    assert ": ValueError: no statexxx" in reasons(answers)[0]
    assert reasons(answers)[0].endswith("; `fovea swap --fresh` begins without it")
    assert len(reasons(answers)[0]) < 2200
    assert report["restarts"] == {}
    assert_accounts_add_up(report)


def test_a_part_that_prints_without_end_fills_no_disk(tmp_path: Path) -> None:
    size = 80 << 20
    plan = unruly_plan(tmp_path, kind="print", size=size, once=tmp_path / "once")

    report = go(plan, 0, recovers)

    assert report["failure"] == ""
    logs = [(base() / plan.name / name).stat().st_size for name in ("unruly.log",)]
    assert logs[0] < 20 << 20


def line_of(event: Event) -> bytes:
    return as_line(encode(event))


def ends() -> tuple[Channel, socket.socket]:
    ours, theirs = socket.socketpair()
    return Channel(ours), theirs


def test_a_flood_of_events_is_heard_in_part_and_counted() -> None:
    channel, node = ends()
    with node:
        node.setblocking(False)
        node.send(line_of(NEXT) * 5000)
        heard = len(channel.events())

        assert MOST_LINES_S <= heard < 3 * MOST_LINES_S
        assert channel.left_out > 0
        assert channel.flooded
        channel.close()


@pytest.mark.parametrize(
    "line",
    [
        b"no message",
        b"[]",
        b"\xf5",
        b"[" * 100_000,
        b"\xff\xfe",
        b"9" * 10_000,
        bytes((MARKER, VERSION + 1)) + encode(NEXT)[2:].replace(b"\n", b""),
        encode(StopOrder()),
    ],
)
def test_a_line_that_is_no_event_is_counted_and_left_out(line: bytes) -> None:
    channel, node = ends()
    with node:
        node.sendall(line + b"\n" + line_of(NEXT))

        assert channel.events() == [NEXT]
        assert channel.left_out == 1
        channel.close()


def test_a_line_without_an_end_takes_no_more_memory_than_is_allowed() -> None:
    channel, node = ends()
    with node:
        node.setblocking(False)
        sent = 0
        while sent < 3 * MOST_LINE:
            sent += node.send(b"x" * 60_000)
            assert channel.events() == []
        node.setblocking(True)
        node.sendall(b"\n" + line_of(NEXT))

        assert channel.events() == [NEXT]
        channel.close()


def test_a_node_that_does_not_read_is_marked_and_does_not_block_the_writer() -> None:
    channel, node = ends()
    with node:
        for _ in range(2 + MOST_UNSENT // 1_000_000):
            channel.send(Uncut("x" * 1_000_000))

        assert channel.deaf
        channel.close()


def test_the_last_event_of_a_node_is_received_after_its_end() -> None:
    channel, node = ends()
    failed = Failed("a\nb\x1b0", False)  # with the end of a line and its escape sequence
    node.sendall(line_of(failed))
    node.close()

    channel.close()

    assert channel.events() == [failed]


def test_all_events_of_a_node_that_ended_are_received_whatever_their_number() -> None:
    channel, node = ends()
    last = Failed("the last", False)
    node.sendall(line_of(NEXT) * 150 + line_of(last))
    node.close()

    channel.close()

    events = channel.events()
    assert (len(events), events[-1], channel.left_out) == (151, last, 0)


def test_events_beyond_what_is_kept_are_counted() -> None:
    channel, node = ends()
    last = Failed("the last", False)
    node.sendall(line_of(NEXT) * 400 + line_of(last))
    node.close()

    channel.close()

    events = channel.events()
    assert events[-1] == last
    assert len(events) + channel.left_out == 401


def test_an_exchange_wakes_for_events_and_on_request() -> None:
    exchange = Exchange()
    channel, node = ends()
    exchange.add(channel)
    with node:
        for wake in (lambda: node.sendall(line_of(NEXT)), exchange.wake):
            began_s = time.monotonic()
            wake()
            exchange.wait(120)
            assert time.monotonic() - began_s < 60
            channel.events()
    exchange.remove(channel)
    channel.close()
    exchange.close()
