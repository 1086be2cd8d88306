"""Files that are a pipe, a device or too long are refused at once, whatever reads them."""

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.cameras import address
from drivers.cameras.address import read_credentials
from drivers.datasets import pictures, sequence
from drivers.datasets.pictures import read_picture
from drivers.datasets.sequence import read_ini, read_rows
from drivers.datasets.texts import files
from drivers.regular_file import contents, opened
from pipeline.errors import DriverError

READERS: dict[str, tuple[Callable[[Path], Any], int]] = {  # and the most bytes of a file
    "picture.jpg": (read_picture, pictures.MOST_BYTES),
    "seqinfo.ini": (read_ini, sequence.MOST_INI_BYTES),
    "gt.txt": (lambda path: list(read_rows(path, columns=6)), sequence.MOST_ROWS_BYTES),
    "labels.json": (files.read_json, files.MOST_BYTES),
    "credentials": (lambda path: read_credentials(str(path)), address.MOST_BYTES),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "long"])
def test_what_is_no_file_of_the_expected_length_is_refused_at_once(
    tmp_path: Path, name: str, kind: str
) -> None:
    path, (read, most_bytes) = tmp_path / name, READERS[name]
    if kind == "pipe":
        os.mkfifo(path, 0o600)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.touch(0o600)
        os.truncate(path, most_bytes + 1)  # sparse

    with pytest.raises(DriverError, match=f"{name}: .*expected (a file|at most {most_bytes})"):
        within_a_second(lambda: read(path))


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "grows"
    path.write_bytes(b"abc")

    with opened(path, 3) as file:
        path.write_bytes(b"abcd")
        with pytest.raises(DriverError, match="expected at most 3 bytes, got more"):
            contents(path, file, 3)


def within_a_second(act: Callable[[], Any]) -> None:
    """Do it in a thread and raise what it raises."""
    raised: list[Exception] = []

    def run() -> None:
        try:
            act()
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(1)
    assert not thread.is_alive()
    if raised:
        raise raised[0]
