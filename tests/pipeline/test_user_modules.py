"""Modules of the current folder are found, and take the place of none that fovea needs."""

import subprocess
import sys
from pathlib import Path

import pytest

from pipeline import RunError
from pipeline.import_path import imported
from pipeline.user_modules import interpreter_options

GRAPH = """\
nodes:
  ticker: {operator: tests.samples:Ticker, settings: {rate_hz: 50}}
  mine: {operator: MODULE, inputs: {frame: ticker.context}}
"""
OPERATOR = """\
from tests.samples import Pass

class Mine(Pass):
    pass
"""
NEEDED = ("queue", "socket", "pipeline", "operators", "drivers", "dataclasses")


def fovea(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run the command as installed: without the current folder at the head of the path."""
    command = [sys.executable, "-P", "-m", "pipeline.entry", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with an operator, and with modules that fovea must not import."""
    (tmp_path / "mine.py").write_text(OPERATOR)
    for name in NEEDED:
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('another module')\n")
    return tmp_path


@pytest.mark.parametrize("way", [(), ("--inline",)])
def test_files_of_the_user_hide_no_module_of_python_or_fovea(
    folder: Path, way: tuple[str, ...]
) -> None:
    (folder / "own.yaml").write_text(GRAPH.replace("MODULE", "mine:Mine"))

    ended = fovea(folder, "run", "own.yaml", "--frames", "3", *way)

    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "another module" not in ended.stdout + ended.stderr
    assert "losses: none" in ended.stdout


def test_a_folder_that_is_removed_meanwhile_hides_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()

    assert interpreter_options() == ["-P"]
    with pytest.raises(RunError, match="neither in a folder that was removed nor installed"):
        imported("nowhere:Mine", RunError)


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("queue:Mine", "queue.py has the name of another module: rename it"),
        ("inner:Mine", "inner/inner.py is found from the folder inner: start fovea there"),
        ("nowhere:Mine", "No module named 'nowhere', neither in "),
    ],
)
def test_a_module_that_is_not_found_is_answered_with_what_helps(
    folder: Path, module: str, said: str
) -> None:
    (folder / "inner").mkdir()
    (folder / "inner" / "inner.py").write_text(OPERATOR)
    (folder / "own.yaml").write_text(GRAPH.replace("MODULE", module))

    ended = fovea(folder, "check", "own.yaml")

    assert ended.returncode == 2
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr
