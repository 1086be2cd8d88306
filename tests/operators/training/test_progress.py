"""A training shows its current phase: a bar in a terminal, a line in a pipe."""

import subprocess
import sys

import pytest

from operators.training.progress import Phases, bar, each_of, tracked

PHASES = Phases("record clips", "train", "score")


def test_a_phase_is_announced_with_its_number() -> None:
    assert [PHASES[name] for name in PHASES.names] == [
        "phase 1 of 3: record clips", "phase 2 of 3: train", "phase 3 of 3: score",
    ]  # fmt: skip


def test_in_a_pipe_each_phase_is_a_line_on_standard_error(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = list(tracked([1, 2, 3], PHASES["record clips"]))
    endless = list(each_of(iter([4]), "read"))
    with bar(PHASES["train"], 5, 3) as shown:
        shown.step("loss 0.1")

    out, err = capsys.readouterr()

    assert (found, endless, out) == ([1, 2, 3], [4], "")
    assert err.splitlines() == ["phase 1 of 3: record clips", "read", "phase 2 of 3: train"]


def test_a_phase_without_work_is_not_announced(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert list(tracked([], PHASES["record clips"])) == []
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_a_bar_with_the_steps_and_the_figures() -> None:
    script = (
        "from rich.console import Console\n"
        "import operators.training.progress as p\n"
        "p.terminal.console = lambda **how: Console(force_terminal=True, width=120, **how)\n"
        "with p.bar('phase 2 of 3: train', 5, 3) as shown:\n"
        "    shown.step('loss 0.1')\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )

    assert done.returncode == 0, done.stderr
    for word in ("phase 2 of 3: train", "4/5", "loss 0.1"):
        assert word in done.stderr
    assert done.stdout == ""
