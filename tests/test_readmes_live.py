"""Run the commands of the pages: those that end within a minute, and those for a running graph."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.documents import Line, blocks, fenced_lines

pytestmark = pytest.mark.slow
FOVEA = (sys.executable, "-m", "pipeline.entry")
PLACEHOLDERS = ("FILE", "FOLDER", "$USER")
ALONE = ("check", "draw", "run")  # verbs that need no running graph
LONGEST_S = 600.0  # for a command on a busy machine
UP_S = 600.0
PYTHON = {"README.md": "mine", "operators/README.md": "smooth", "drivers/README.md": "noise"}


def page_of(line: Line) -> str:
    return str(line.page.relative_to(ROOT))


def ends_by_itself(line: Line) -> bool:
    """Return whether a command can run as it is written and ends within a minute."""
    program, *words = line.words
    if any(place in word for word in words for place in PLACEHOLDERS):
        return False
    if program == "fovea":
        limited = words[0] != "run" or "--frames" in words
        return words[0] in ALONE and limited
    return words[:2] == ["-m", "bench.results"]


def walk() -> list[Line]:
    """Return the commands of the pages for a running graph, in order."""
    pages = ("README.md", "operators/README.md")
    verbs = ("add", "hz", "echo", "schema", "set", "tell", "swap", "top", "rewire", "remove")
    return [
        line
        for line in fenced_lines()
        if page_of(line) in pages and line.words[0] == "fovea" and line.words[1] in verbs
    ]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder like a reader's: the graphs of the project beside the files of the pages."""
    (tmp_path / "graphs").symlink_to(ROOT / "graphs")
    for page, name in PYTHON.items():
        (tmp_path / f"{name}.py").write_text(blocks("python", [ROOT / page])[0].text)
        for block in blocks("yaml", [ROOT / page]):
            if f"{name}:" in block.text:
                (tmp_path / f"{name}.yaml").write_text(block.text)
    return tmp_path


def done(folder: Path, words: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    program = FOVEA if words[0] == "fovea" else (sys.executable,)
    return subprocess.run(
        [*program, *words[1:]], cwd=folder, capture_output=True, text=True, timeout=LONGEST_S,
        check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "line", [line for line in fenced_lines() if ends_by_itself(line)], ids=lambda line: line.name
)
def test_every_command_that_ends_by_itself_works(line: Line, folder: Path) -> None:
    words = line.words
    if words[1:3] == ("-m", "bench.results"):  # it must not write into the project
        words = (*words, *(() if "--check" in words else ("--out", str(folder / "RESULTS.md"))))

    result = done(folder, words)

    assert result.returncode == 0, f"{result.stdout}{result.stderr}"
    assert "Traceback" not in result.stderr


@pytest.fixture
def graph(folder: Path) -> Iterator[Path]:
    """Yield the folder while the tracking graph runs as in the README."""
    with (folder / "run.log").open("w") as log:
        process = subprocess.Popen(
            [*FOVEA, "run", "graphs/tracking.yaml"], cwd=folder, stdout=log, stderr=log
        )
    try:
        until_s = time.monotonic() + UP_S
        while done(folder, ("fovea", "health", "tracking")).returncode:
            assert process.poll() is None, (folder / "run.log").read_text()
            assert time.monotonic() < until_s, (folder / "run.log").read_text()
        yield folder
        assert process.poll() is None, (folder / "run.log").read_text()
    finally:
        process.terminate()
        process.wait(60)


def test_every_command_for_a_running_graph_works_in_the_order_of_the_pages(graph: Path) -> None:
    lines = walk()
    assert {line.words[1] for line in lines} >= {"add", "swap", "set", "tell", "rewire", "remove"}

    for line in lines:
        once = ("--once",) if line.words[1] == "top" else ()
        result = done(graph, (*line.words, *once))

        assert result.returncode == 0, f"{line.name}: {result.stdout}{result.stderr}"
        assert "Traceback" not in result.stderr
