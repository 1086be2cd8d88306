"""Tests have no access to the user's home and variables, nor to files beside the repository."""

import os
import pwd
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pipeline.run.rundir import base
from pipeline.weights import default_folder, entries, find

LONGEST_SOCKET = 107  # characters that a path may have
ASK = "import pipeline, rich.console, sys; print(pipeline.__file__, rich.console.Console().width)"


def test_the_home_is_private_and_has_no_weights() -> None:
    assert Path.home() != Path(pwd.getpwuid(os.getuid()).pw_dir)
    assert Path.home().is_relative_to(tempfile.gettempdir())
    assert not default_folder().exists()
    assert [name for name in entries() if find(name)] == []


def test_sockets_of_any_graph_have_room_for_their_paths() -> None:
    longest = base() / ("g" * 32) / f"{'n' * 32}.12.sock"

    assert len(str(longest)) <= LONGEST_SOCKET


def test_a_started_process_runs_this_code_in_80_columns(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ASK], cwd=tmp_path, capture_output=True, text=True, check=True
    )

    root = Path(__file__).resolve().parents[1]
    assert done.stdout == f"{root / 'pipeline' / '__init__.py'} 80\n"


def test_footage_is_refused_to_a_test_without_the_mark(request: pytest.FixtureRequest) -> None:
    with pytest.raises(pytest.fail.Exception, match="expected the mark `footage` on it, got none"):
        request.getfixturevalue("footage")
