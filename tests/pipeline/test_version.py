"""A version and its commit: from git in the source tree, as recorded in a wheel, or none."""

import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from pipeline.cli import commands
from pipeline.version import ROOT, commit, described, revision, version

PROJECT = '[project]\nname = "fovea"\nversion = "7.8.9"\n'


def git(folder: Path, *words: str) -> None:
    own = ("-c", "user.name=tester", "-c", "user.email=tester@localhost")
    subprocess.run(["git", "-C", str(folder), *own, *words], check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    (tmp_path / "pyproject.toml").write_text(PROJECT)
    git(tmp_path, "init")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-m", "all")
    return tmp_path


def test_in_the_source_tree_the_commit_comes_from_git_and_changes_are_marked(
    repository: Path,
) -> None:
    clean = commit(repository)
    (repository / "new.txt").write_text("not tracked")
    untracked = commit(repository)
    (repository / "pyproject.toml").write_text(PROJECT + "\n")

    assert len(clean) == 12
    assert untracked == clean
    assert commit(repository) == f"{clean}+"
    assert version(repository) == "7.8.9"


def test_in_a_wheel_the_commit_is_the_recorded_one(tmp_path: Path) -> None:
    (tmp_path / "pipeline").mkdir()
    (tmp_path / "pipeline" / "commit.txt").write_text("0123456789ab\n")

    assert commit(tmp_path) == "0123456789ab"


def test_without_git_and_record_there_is_the_version_alone(
    tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert commit(tmp_path / "nowhere") == ""
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    assert commit(repository) == ""
    assert version(repository) == "7.8.9"


def test_a_surrounding_project_of_another_name_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(PROJECT.replace("fovea", "mine"))

    assert version(tmp_path) != "7.8.9"


def test_the_command_line_prints_version_and_commit() -> None:
    said = CliRunner().invoke(commands, ["--version"]).output

    assert said == f"fovea {described()}\n"
    assert said.startswith(f"fovea {version(ROOT)}")


def test_a_revision_is_the_whole_commit_and_whether_the_code_was_changed_since(
    tmp_path: Path,
) -> None:
    (tmp_path / "a").write_text("1")
    git(tmp_path, "init")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "-m", "first")
    clean = revision(tmp_path)
    (tmp_path / "a").write_text("2")

    assert len(clean[0]) == 40
    assert not clean[1]
    assert revision(tmp_path) == (clean[0], True)


def test_code_outside_any_repository_has_no_revision(tmp_path: Path) -> None:
    assert revision(tmp_path / "nowhere") == ("", False)
