"""A recording that stops growing is truncated to its complete part; replaced files stay."""

from pathlib import Path

import pytest

from pipeline.growing_file import GrowingFile
from tests.pipeline.run.namespaces import with_small_mounts

SCRIPT = """\
import sys
from pathlib import Path
from pipeline.growing_file import GrowingFile

path, when = Path(sys.argv[1]), sys.argv[2]
file = path.open("wb", buffering=0)

def fill():
    while file.write(bytes(3000)) == 3000: pass  # until only a part of it is written

file.write(bytes(8192))
growing = GrowingFile(path, lambda _timeout_s: True)
growing.look(3)
if when == "before a look":
    fill()
    growing.look(7)
print(growing.close(fill if when == "at the end" else file.close) or growing.failure)
print(path.stat().st_size)
"""


def stopped(path: Path, grown: bytes, meanwhile: bytes | None = None) -> GrowingFile:
    """Return a recording whose writer stopped after `grown`; a file `meanwhile` takes its name."""
    answers = iter([True, False, False])
    path.write_bytes(b"whole")
    file = GrowingFile(path, lambda _: next(answers))
    file.look(7)
    with path.open("ab") as opened:
        opened.write(grown)
    if meanwhile is not None:
        path.rename(path.with_name("moved"))
        path.write_bytes(meanwhile)
    file.look(8)
    file.look(9)
    return file


def test_a_recording_is_truncated_to_its_last_complete_part(tmp_path: Path) -> None:
    file = stopped(tmp_path / "x.rrd", b"torn")

    assert (tmp_path / "x.rrd").read_bytes() == b"whole"
    assert "it can be read up to frame 7" in file.failure


def test_another_file_that_has_taken_its_name_is_not_cut(tmp_path: Path) -> None:
    file = stopped(tmp_path / "x.rrd", b"torn", meanwhile=b"of the user, and longer")

    assert (tmp_path / "x.rrd").read_bytes() == b"of the user, and longer"
    assert file.failure


@pytest.mark.parametrize("when", ["before a look", "at the end"])
def test_a_partial_write_is_cut_off_and_reported(tmp_path: Path, when: str) -> None:
    small = tmp_path / "small"
    small.mkdir()

    done = with_small_mounts({small: "64k"}, "-c", SCRIPT, str(small / "x.rrd"), when)

    assert done.stdout.splitlines() == [
        f"{small / 'x.rrd'}: the disk is full; it can be read up to frame 3", "8192",
    ], done.stderr  # fmt: skip


def test_a_file_that_is_whole_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    path.write_bytes(bytes(100))
    growing = GrowingFile(path, lambda _timeout_s: True)
    growing.look(3)

    def end() -> None:
        path.write_bytes(bytes(120))

    assert growing.close(end) == ""
    assert (path.stat().st_size, growing.ended) == (120, True)
