"""`fovea new` makes folders that run at once, and nothing where something is."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.cli.new import KINDS, check_new_name, create
from pipeline.errors import SettingsError
from tests.commands import command

PYTHON = (sys.executable, "-m")


def done(folder: Path, *words: str) -> str:
    """Run a module in a folder and return its output; it must succeed."""
    ran = subprocess.run(
        [*PYTHON, *words], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout + ran.stderr


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kind", KINDS)
def test_the_generated_test_passes_and_the_code_is_well_formed(kind: str, here: Path) -> None:
    folder = here / "my_part"

    said = command("new", kind, "my_part")

    assert said.returncode == 0, said.stderr
    assert {"my_part.py", "my_part.yaml", "test_my_part.py", "README.md"} <= {
        path.name for path in folder.iterdir()
    }
    assert " passed" in done(folder, "pytest", "-q", "-p", "no:cacheprovider", "-W", "error")
    done(folder, "ruff", "check", "--isolated", "--select", "E,F,B", "--line-length", "100", ".")


@pytest.mark.parametrize("kind", KINDS)
def test_the_generated_graph_runs_as_processes(kind: str, here: Path) -> None:
    create(kind, "my_part", here)

    said = done(here / "my_part", "pipeline.entry", "run", "my_part.yaml", "--frames", "10")

    assert "10 frames" in said


def test_the_generated_driver_is_tested_as_its_readme_says(here: Path) -> None:
    create("driver", "my_part", here)
    folder = here / "my_part"
    (line,) = [
        line for line in (folder / "README.md").read_text().splitlines() if "sensors test" in line
    ]
    words = line.partition("#")[0].split()[1:]

    said = done(folder, "pipeline.entry", *words, "--seconds", "1")

    assert "the contract is kept" in said


@pytest.mark.lengthy
def test_the_generated_task_is_evaluated_by_its_file(here: Path) -> None:
    create("task", "my_part", here)

    said = done(
        here / "my_part", "pipeline.entry", "eval", "task.yaml", "--frames", "2", "--seeds", "1"
    )

    assert "oracle" in said


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../escape", "expected a name of up to 32"),
        ("/tmp/x", "expected a name of up to 32"),
        ("", "expected a name of up to 32"),
        ("Upper", "expected a name of up to 32"),
        ("a" * 33, "expected a name of up to 32"),
        ("lambda", "used by Python"),
        ("frame", "used by Python or by the code"),  # its class would hide the message
        ("camera", "used by Python or by the code"),  # a node of the graph
        ("json", "already a module json"),
        ("msgspec", "already a module msgspec"),
        ("testbed", "does not begin with test"),
        ("pipeline", "already a module pipeline"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused_and_writes_nothing(
    name: str, said: str, here: Path
) -> None:
    got = command("new", "operator", name)

    assert got.returncode == 2
    assert said in got.stderr
    assert len(got.stderr.splitlines()) == 1
    assert list(here.iterdir()) == []


@given(st.text(st.sampled_from("ab_0/.\\\n A\0é"), max_size=40))
def test_a_name_that_is_accepted_never_acts_as_a_path(name: str) -> None:
    try:
        accepted = check_new_name("operator", name)
    except SettingsError:
        return
    assert accepted == Path(accepted).name
    assert accepted.isidentifier()


@pytest.mark.parametrize("there", ["folder", "file", "link"])
def test_what_exists_is_never_overwritten(there: str, here: Path) -> None:
    path, elsewhere = here / "mine", here / "elsewhere"
    if there == "folder":
        path.mkdir()
    elif there == "file":
        path.write_text("kept")
    else:
        path.symlink_to(elsewhere)

    got = command("new", "task", "mine")

    assert (got.returncode, got.stderr) == (
        2,
        "fovea: new task: mine exists; nothing was written\n",
    )
    assert not elsewhere.exists()
    assert path.read_text() == "kept" if there == "file" else not any(path.glob("*"))


def test_a_folder_that_cannot_be_written_to_is_one_sentence(here: Path) -> None:
    (here / "gone").mkdir()
    os.chdir(here / "gone")
    (here / "gone").rmdir()

    got = command("new", "operator", "mine")

    assert got.returncode == 1
    assert len(got.stderr.splitlines()) == 1
    assert "No such file or directory" in got.stderr


def test_a_failure_half_way_leaves_nothing(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, text: str, encoding: str) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)

    with pytest.raises(OSError, match="No space"):
        create("operator", "mine", here)

    assert list(here.iterdir()) == []
