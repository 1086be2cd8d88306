"""The log of a process takes all of its output, is private and bounded, and never ends it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

BEGINNING = """\
import os, subprocess, sys
from pathlib import Path
from pipeline.node.logfile import log_to
file = log_to(Path({path!r}), fresh={fresh}, most_bytes={most_bytes})
"""


def process(path: Path, what: str, *, fresh: bool = True, most_bytes: int = 1 << 20) -> None:
    """Run a process with a log that does something, and ends well."""
    begin = BEGINNING.format(path=str(path), fresh=fresh, most_bytes=most_bytes)
    done = subprocess.run([sys.executable, "-c", begin + what], capture_output=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_output_of_the_process_of_its_libraries_and_of_its_children_is_in_the_log(
    tmp_path: Path,
) -> None:
    path = tmp_path / "eye.log"

    process(
        path,
        "print('printed')\n"
        "os.write(1, b'by a library\\n')\n"
        "os.write(2, b'by another\\n')\n"
        "subprocess.run(['echo', 'by a child'])\n",
    )

    assert path.read_text() == "printed\nby a library\nby another\nby a child\n"


@pytest.mark.parametrize(("fresh", "text"), [(True, "new\n"), (False, "old\nnew\n")])
def test_a_log_begins_anew_or_goes_on(tmp_path: Path, fresh: bool, text: str) -> None:
    path = tmp_path / "eye.log"
    path.write_text("old\n")

    process(path, "print('new')", fresh=fresh)

    assert path.read_text() == text


def test_only_the_user_may_read_a_log(tmp_path: Path) -> None:
    path = tmp_path / "eye.log"
    before = os.umask(0)
    try:
        process(path, "")
    finally:
        os.umask(before)

    assert path.stat().st_mode & 0o777 == 0o600


def test_what_comes_after_a_full_log_is_in_a_new_one_also_from_libraries(tmp_path: Path) -> None:
    path = tmp_path / "eye.log"

    process(
        path,
        "print('x' * 200)\n"
        "print('after')\n"
        "os.write(2, b'by a library\\n')\n",
        most_bytes=100,
    )  # fmt: skip

    assert path.with_name("eye.log.old").read_text() == "x" * 200 + "\n"
    assert path.read_text() == "after\nby a library\n"


def test_an_operator_may_lead_its_standard_output_elsewhere(tmp_path: Path) -> None:
    path, own = tmp_path / "eye.log", tmp_path / "own"

    process(
        path,
        f"os.dup2(os.open({str(own)!r}, os.O_WRONLY | os.O_CREAT), 1)\n"
        "print('x' * 200)\n"  # by the log's own descriptor
        "print('after')\n"
        "os.write(1, b'its own')\n",
        most_bytes=100,
    )

    assert own.read_text() == "its own"
    assert path.read_text() == "after\n"


def test_on_a_full_disk_output_is_lost_and_the_process_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "eye.log"

    process(
        path,
        "from tests.full_disk import full_disk\n"
        "with full_disk(1000):\n"
        "    print('x' * 999)\n"
        "    print('lost')\n"
        "print('after')\n",
    )

    assert path.read_text() == "x" * 999 + "\nafter\n"
