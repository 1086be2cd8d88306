"""A training holds its folder: no other one mixes its log and checkpoint with them."""

import subprocess
import sys
from pathlib import Path

import pytest

from operators.training.folder import open_folder
from pipeline import SettingsError

HOLDS = """
import sys
from pathlib import Path
from operators.training.folder import open_folder
open_folder(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_folder_in_which_another_process_trains_is_refused_until_that_is_killed(
    tmp_path: Path,
) -> None:
    out = tmp_path / "new" / "out"
    command = [sys.executable, "-c", HOLDS, str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"

        with pytest.raises(SettingsError, match="out: another training runs in this folder"):
            open_folder(out)
        other.kill()
        other.wait()

    open_folder(out)


def test_one_process_may_train_twice_in_a_folder(tmp_path: Path) -> None:
    open_folder(tmp_path)
    open_folder(tmp_path / "../" / tmp_path.name)

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", ["/proc/self/training", "/proc"])
def test_a_folder_that_cannot_be_written_is_refused(out: str) -> None:
    with pytest.raises((SettingsError, OSError), match="/proc"):
        open_folder(Path(out))
