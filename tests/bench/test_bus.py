"""Every contestant has a turn in each round, and figures are computed from its clocks."""

import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bus import CONTESTANTS, ROOT, is_installed, read_sizes, run_to_end, schedule
from bench.bus_figures import summarise, table
from tests.sample_graphs import ended, until

MS = 1_000_000


@given(
    modules=st.lists(st.text(min_size=1), min_size=1, max_size=6, unique=True),
    rounds=st.integers(1, 5),
    seed=st.integers(),
)
def test_every_round_has_one_turn_per_contestant_and_size(
    modules: list[str], rounds: int, seed: int
) -> None:
    sizes = [64, 128]

    turns = schedule(modules, sizes, rounds, seed)

    assert turns == schedule(modules, sizes, rounds, seed)
    for first in range(0, len(turns), len(modules)):
        block = turns[first : first + len(modules)]
        assert Counter(module for module, _ in block) == Counter(modules)
        assert len({nbytes for _, nbytes in block}) == 1


def result(contestant: str, beyond_ms: list[int], sent: int) -> dict[str, Any]:
    samples = [
        [k, 0, MS, 3 * MS, (2 + late) * MS, (6 + late) * MS] for k, late in enumerate(beyond_ms)
    ]
    return {
        "contestant": contestant, "version": "1", "nbytes": 64, "rate_hz": 30.0, "sent": sent,
        "sender_cpu_ns": 8 * MS, "receiver_cpu_ns": 4 * MS, "bare_write_ns": [MS],
        "bare_read_ns": [MS], "torn": 0, "samples": samples,
    }  # fmt: skip


def test_figures_exclude_writing_and_reading_and_count_lost_messages() -> None:
    turns = [result("fovea_bus", [2, 3, 4], sent=4), result("fovea_bus", [5, 6, 7], sent=4)]

    (row,) = summarise(turns)

    assert row["beyond_ms"]["p50"] == 4.5
    assert row["beyond_ms"]["min"] == 2
    assert row["p50_rounds"] == [3, 6]
    assert (row["write_ms"]["p50"], row["read_ms"]["p50"]) == (2, 4)
    assert (row["sent"], row["lost"]) == (8, 2)
    assert (row["sender_cpu_ms"], row["receiver_cpu_ms"]) == (2, 1)


def test_the_table_puts_the_quickest_first_and_names_the_ratio() -> None:
    figures = summarise([
        result("fovea_bus", [4], sent=1), result("other", [2], sent=1), result("mute", [], sent=1),
    ])  # fmt: skip

    shown = table(figures, 64, {"other": "the other"})

    columns = [list(column.cells) for column in shown.columns]
    assert columns[0] == ["the other", "fovea_bus", "mute"]
    assert columns[4] == ["0.50", "1.00", "nan"]


def test_a_turn_beyond_its_limit_is_killed_with_its_descendants(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    script = 'sleep 1000 & echo $! > "$0.part"; mv "$0.part" "$0"; wait'

    for limit_s in (0.5, 5.0, 50.0):  # a busy machine begins late
        with pytest.raises(subprocess.TimeoutExpired):
            run_to_end(["sh", "-c", script, str(note)], limit_s)
        if note.exists():
            break

    until(lambda: ended(int(note.read_text())))


def test_a_failed_turn_raises_with_the_last_line_of_its_errors() -> None:
    with pytest.raises(subprocess.SubprocessError, match="ended with 3: no such luck"):
        run_to_end(["sh", "-c", "echo no such luck >&2; exit 3"], 60.0)


def test_a_contestant_without_its_library_is_left_out(tmp_path: Path) -> None:
    left = [c.module for c in CONTESTANTS if is_installed(c, tmp_path)]

    assert left == [c.module for c in CONTESTANTS if c.ours]


def test_every_contestant_is_a_script() -> None:
    for contestant in CONTESTANTS:
        assert (ROOT / "bench" / "peers" / f"{contestant.module}.py").is_file()


@pytest.mark.parametrize("words", ["a few", "64", ""])
def test_invalid_sizes_are_refused(words: str) -> None:
    with pytest.raises(click.BadParameter, match="--sizes"):
        read_sizes(words)
