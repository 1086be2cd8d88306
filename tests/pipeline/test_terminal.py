"""The output of a run can be read in a narrow terminal."""

import logging
from pathlib import Path

import pytest
from rich.console import Console

from pipeline.bus.ledger import private_ledger
from pipeline.graph.loader import load
from pipeline.run.report import compose, tables
from pipeline.terminal import cropped, log_handler, losses, rest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("frames", [600, 54_000, 2_600_000])  # a day at 30 fps
def test_every_name_and_figure_of_the_shipped_graph_stands_whole_in_80_columns(
    frames: int,
) -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    for account in ledger.edges:
        account.sent, account.delivered, account.superseded = frames, frames - 7, 5
        for age_ms in (23, 412):
            account.age.add(age_ms * 1_000_000)
    console = Console(width=80)

    with console.capture() as caught:
        console.print(tables(compose(plan, ledger, {}, {}, duration_s=1.0)))

    rows = [line.split() for line in caught.get().splitlines()]
    for edge in plan.edges:
        kept = [edge.origin, edge.end, edge.keep, str(frames), str(frames - 7), "7"]
        assert kept in [row[:6] for row in rows]
        assert f"{edge.origin} -> {edge.end}: 5 dropped, superseded" in caught.get()


def test_undelivered_messages_are_counted_and_losses_are_named() -> None:
    account = {"offered": 9, "delivered": 4, "dropped": {"superseded": 3}, "lost_in_crash": 1}
    whole = {"offered": 9, "delivered": 8, "dropped": {}, "lost_in_crash": 0, "unexpected": 0}

    assert rest(account) == "5"
    assert [line.plain for line in losses("a", "b", whole | {"unexpected": 2}, broken=False)] == [
        "a -> b: 2 ignored, damaged or sent twice"
    ]
    assert [line.plain for line in losses("a", "b.in", account, broken=True)] == [
        "a -> b.in: 3 dropped, superseded; 1 lost with a process; lost messages it was promised"
    ]
    assert list(losses("a", "b.in", whole, broken=False)) == []


def test_output_too_tall_for_a_terminal_is_cropped_with_a_count_of_missing_lines() -> None:
    console = Console(width=80, height=10)
    tall, low = "\n".join(f"row {n}" for n in range(30)), "row 0"

    with console.capture() as caught:
        console.print(cropped(tall, console), end="")

    lines = caught.get().splitlines()
    assert len(lines) == 10
    assert lines[8] == "row 8"
    assert lines[9].startswith("21 lines more")
    assert cropped(low, console) == low


def test_a_record_that_goes_to_a_file_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    words = "topology: " + ", ".join(f"node-{n}" for n in range(60))

    log_handler().emit(logging.LogRecord("fovea", logging.INFO, "", 0, words, None, None))

    (line,) = capsys.readouterr().out.splitlines()
    assert line.endswith(f" INFO     {words}")


def test_a_log_beside_a_result_is_written_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    said = logging.LogRecord("fovea", logging.INFO, "", 0, "found no library", None, None)

    log_handler(stderr=True).emit(said)

    written = capsys.readouterr()
    assert "found no library" in written.err
    assert written.out == ""
