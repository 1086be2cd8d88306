"""An operator that breaks under `fovea run --inline` is reported in one sentence."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.run.loaded_graph import load
from tests.unruly_graphs import name_of, unruly_file

FOVEA = (sys.executable, "-m", "pipeline.entry", "run", "--inline", "--frames", "20")
SAMPLES = Path(__file__).parents[2] / "faulty_samples.py"
KINDS = {
    "exit_0": "it exits: os._exit(0)",
    "system_exit": "it exits: 0",
    "keyboard_interrupt": "KeyboardInterrupt",
    "group": "BaseExceptionGroup: both (2 sub-exceptions)",
    "thread": "ValueError: in a thread",
    "mute": "Mute: (its text cannot be had: RuntimeError)",
    "odd_text": "ValueError: odd \\ud800\\x1b[2J\\x00\\u202e text and more",
    "exit_in_close": "it exits: os._exit(0)",
    "exit_in_summary": "it exits: 0",
}


def run(graph: Path, *words: str) -> tuple[int, str, str, dict[str, object]]:
    """Run a graph; return exit status, standard output and error, and the report."""
    path = graph.parent / "report.json"
    done = subprocess.run(
        [*FOVEA, *words, "--report", str(path), str(graph)],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    report = json.loads(path.read_text()) if path.exists() else {}
    return done.returncode, done.stdout, done.stderr, report


@pytest.mark.parametrize("kind", KINDS)
def test_an_operator_that_breaks_is_reported_in_one_sentence_with_node_and_line(
    tmp_path: Path, kind: str
) -> None:
    graph = unruly_file(tmp_path, kind=kind)

    status, out, err, report = run(graph)

    assert status == 2
    where = f"{name_of(graph)}: a thread" if kind == "thread" else "unruly"
    assert err.startswith(f"Error: {where}: {SAMPLES}:")
    assert err.endswith(f": {KINDS[kind]}\n")
    assert err.count("\n") == 1
    assert report["failure"] == err.removeprefix("Error: ").strip()
    assert "edges" in report
    assert "losses: " in out
    assert "Traceback" not in out + err


def test_a_text_without_end_is_cut(tmp_path: Path) -> None:
    status, out, err, _ = run(unruly_file(tmp_path, kind="long_text", size=100_000))

    assert status == 2
    assert ": ValueError: xxx" in err
    assert len(err) < 1000
    assert len(out) < 1000


def test_the_traceback_comes_with_verbose_bounded_and_harmless(tmp_path: Path) -> None:
    _, out, err, _ = run(unruly_file(tmp_path, kind="odd_text"), "--verbose")
    assert "Traceback (most recent call last):" in out
    assert f'File "{SAMPLES}"' in out.replace("\n", "")
    assert "\x1b[2J" not in out + err

    _, out, _, _ = run(unruly_file(tmp_path, kind="long_text", size=100_000), "--verbose")
    assert len(out) < 30_000


def test_an_operator_that_cannot_be_opened_ends_the_run_before_it_began(tmp_path: Path) -> None:
    status, _, err, report = run(unruly_file(tmp_path, kind="exit_in_open"))

    assert (status, report) == (1, {})
    assert err.startswith(f"fovea: unruly: {SAMPLES}:")
    assert err.endswith(": it exits: 0\n")


def test_in_a_script_what_an_operator_raises_passes_through(tmp_path: Path) -> None:
    graph = load(unruly_file(tmp_path, kind="odd_text"))

    with pytest.raises(ValueError, match="odd"):
        graph.run(20)
