"""`echo` and `hz` on running graphs measure the output without affecting the graph."""

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pipeline import Frame, RunError
from pipeline.bus.tap import Heard, Missed
from pipeline.client import listening
from pipeline.client.find import find
from pipeline.client.listening import figures, line, rate_line
from pipeline.protocol.orders import SwapOrder
from pipeline.run.rundir import folder_of
from pipeline.run.supervisor import Supervisor
from pipeline.testing import header
from tests.sample_graphs import (
    CHAIN,
    assert_accounts_add_up,
    beside,
    edge,
    go,
    plan_of,
    send_signal,
    together,
    wait_for,
)

FOVEA = (sys.executable, "-m", "pipeline.cli")
UNREAD = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {rate_hz: 60, side_px: 300}
  glance:
    operator: tests.samples:Pass
    inputs: {frame: ticker.roi}
"""


def echo(graph: str, output: str, count: int) -> Iterator[str]:
    return map(line, listening.echo(find(graph).listen(output), count))


def rate(graph: str, output: str, duration_s: float) -> str:
    return rate_line(listening.rate(find(graph).listen(output), duration_s), duration_s)


def seqs(lines: list[str]) -> list[int]:
    return [int(line.split()[1]) for line in lines if line.startswith("seq")]


def missing(lines: list[str]) -> int:
    return sum(int(line.split()[1].rstrip(":")) for line in lines if line.startswith("missed"))


@pytest.mark.parametrize("output", ["glance", "ticker.context"])
def test_every_message_of_an_unread_output_is_received_or_counted_as_missed(
    output: str, tmp_path: Path
) -> None:
    plan, lines = plan_of(tmp_path, UNREAD), list[str]()

    def during(supervisor: Supervisor) -> None:
        lines.extend(beside(supervisor, lambda: list(echo(plan.name, output, 40))))
        supervisor.finish()

    go(plan, 0, during)

    found = seqs(lines)
    assert len(found) == 40
    unheard = found[-1] - found[0] + 1 - len(found)
    # glance may have skipped a frame, for which its output has no message
    assert missing(lines) == unheard if output != "glance" else missing(lines) <= unheard


def test_the_rate_of_an_output_that_nobody_reads_is_its_own(tmp_path: Path) -> None:
    plan, lines, sent = plan_of(tmp_path, UNREAD), list[str](), list[float]()

    def measured(supervisor: Supervisor) -> None:
        account = supervisor.ledger.nodes[plan.node("glance").index]

        def look() -> None:
            began, handled = time.monotonic(), account.handled
            lines.append(rate(plan.name, "glance", 2.0))
            sent.append((account.handled - handled) / (time.monotonic() - began))

        beside(supervisor, look)
        supervisor.finish()

    go(plan, 0, measured)

    hertz = float(lines[0].split(" Hz")[0].split()[-1])
    assert sent[0] / 2 < hertz < 2 * sent[0], (lines, sent)  # not measured over the same time


@pytest.mark.lengthy
def test_echo_goes_on_across_a_restart_and_a_swap(tmp_path: Path) -> None:
    plan, lines = plan_of(tmp_path, UNREAD), list[str]()

    def during(supervisor: Supervisor) -> None:
        listener = beside(supervisor, lambda: find(plan.name).listen("glance"))

        def more(wanted: int) -> None:
            def hear() -> None:
                end = time.monotonic() + 60
                while wanted > len(lines) and time.monotonic() < end:
                    one = tap.next(0.5)
                    lines.extend([str(one.header.seq)] if one else [])

            beside(supervisor, hear)
            assert len(lines) >= wanted

        with listener:
            tap = listener.tap
            more(5)
            send_signal(supervisor, "glance", signal.SIGKILL)
            wait_for(supervisor, lambda: supervisor.restarts.get("glance") == 1)
            more(tap.instances and len(lines) + 20)
            assert tap.instances == 2
            beside(supervisor, partial(find(plan.name).swap, SwapOrder(node="glance", probation=5)))
            more(len(lines) + 200)
            assert tap.instances == 3
            assert tap.missed.refused == 0
        supervisor.finish()

    go(plan, 0, during)

    numbers = [int(line) for line in lines]
    assert numbers == sorted(set(numbers))


def test_echo_ends_when_its_node_is_removed_and_when_its_graph_ends(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, UNREAD)

    def during(supervisor: Supervisor) -> None:
        lines = echo(plan.name, "glance", 0)
        beside(supervisor, lambda: next(lines))
        beside(supervisor, lambda: find(plan.name).remove("glance"))
        rest = beside(supervisor, lambda: list(lines))
        assert rest[-1] == f"{plan.name}: glance was removed"
        left.append(echo(plan.name, "ticker.roi", 10_000))
        beside(supervisor, lambda: next(left[0]))
        supervisor.finish()

    left: list[Iterator[str]] = []
    go(plan, 0, during)

    with pytest.raises(RunError, match=r"has ended after \d+ of 10000 messages of ticker\.roi"):
        list(left[0])


def started(*words: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [*FOVEA, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.lengthy
def test_taps_that_are_stopped_or_killed_cost_the_graph_nothing_and_leave_nothing(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, together(CHAIN, "ticker", "count"), changes=("ticker.side_px=300",))
    taps: list[subprocess.Popen[str]] = []
    names: list[set[str]] = []

    def during(supervisor: Supervisor) -> None:
        folder, ledger = folder_of(plan.name), supervisor.ledger
        names.append(set(os.listdir(folder)))
        outputs = ("glance", "ticker.roi", "ticker.roi")
        taps.extend(started("echo", plan.name, output) for output in outputs)
        for tap in taps:
            assert tap.stdout is not None
            assert beside(supervisor, tap.stdout.readline)
            os.kill(tap.pid, signal.SIGSTOP)
        account = ledger.nodes[plan.node("glance").index]
        handled = account.handled
        wait_for(supervisor, lambda: account.handled > handled + 40)  # two seconds
        for tap in taps:
            tap.kill()
            tap.communicate()
        names.append(set(os.listdir(folder)))
        supervisor.finish()

    report = go(plan, 0, during)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["dropped"] == {}  # no overrun: no slot was held
    assert edge(report, "count.frame")["delivered"] == report["frames"]["exposed"]
    assert names[1] - names[0] == set()


def of(output: str, heard: list[Heard], missed: Missed, now_ns: int, duration_s: float) -> str:
    return rate_line(figures(output, heard, missed, now_ns, duration_s), duration_s)


def heard_every(gap_ms: float, *seqs: int, lost_before: tuple[int, ...] = ()) -> list[Heard]:
    pixels = np.zeros((1, 1, 3), np.uint8)
    return [
        Heard(
            int(seq * gap_ms * 1e6), header(seq), Frame(header=header(seq), pixels=pixels),
            seq in lost_before,
        )
        for seq in seqs
    ]  # fmt: skip


def test_the_rate_counts_what_was_missed_and_the_jitter_does_not() -> None:
    heard = heard_every(10.0, 0, 1, 2, 6, 7, lost_before=(6,))

    said = of("eye", heard, Missed(on_the_way=3), heard[-1].at_ns, 1.0)

    assert said.startswith("eye: 100.00 Hz, gap 10.0 .. 10.0 ms (std 0.00)")
    assert said.endswith("5 messages; missed 3: 3 lost on the way")


def test_an_output_that_falls_silent_does_not_keep_its_rate() -> None:
    heard = heard_every(10.0, *range(101))

    said = of("eye", heard, Missed(), heard[-1].at_ns + 3_000_000_000, 4.0)

    assert said.startswith("eye: 25.25 Hz")
    assert "none in the last 3.0 s" in said


def test_without_a_message_the_rate_is_an_error_that_counts_the_nones() -> None:
    nothing = [Heard(0, header(0), None, False), Heard(1, header(1), None, False)]

    with pytest.raises(RunError, match=r"eye: no message in 1\.0 s, 2 times nothing"):
        figures("eye", nothing, Missed(), 5, 1.0)


def test_an_output_that_does_not_exist_gets_a_suggestion(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=f"no graph {(name := 'none-' + secrets.token_hex(3))} runs"):
        find(name).listen("eye")
