"""Files on the side of the commands that were damaged or cannot be read: one sentence tells it."""

from pathlib import Path

import pytest

from pipeline.errors import RunError, SettingsError
from pipeline.fleet.hosts import Hosts, known_addresses
from pipeline.fleet.remembered import remember, remembered
from pipeline.fleet.secure import ADDRESSES

HOSTS = Hosts({"eye": "there"}, "credentials", {"capture": "eye"})
DAMAGED = (
    b"",
    b"[]",
    b"3",
    b"null",
    b'{"g": []}',
    b'{"g": {"points": {"eye": 3}}}',
    b'{"\xff": {}}',
    b'{"g": {"k": ' + b"[" * 100_000,
)


def record() -> Path:
    """Return the file of deployed graphs, which is there."""
    remember("duo", HOSTS)
    (file,) = Path.home().rglob("fleet.json")
    return file


def test_what_was_remembered_is_read_again() -> None:
    remember("duo", HOSTS)

    assert remembered() == {"duo": HOSTS}


@pytest.mark.parametrize("data", DAMAGED)
def test_a_damaged_record_of_deployed_graphs_is_refused(data: bytes) -> None:
    file = record()
    file.write_bytes(data)

    with pytest.raises(RunError, match=r"fleet\.json: not what `fovea up` wrote: "):
        remembered()


def test_a_record_of_deployed_graphs_that_cannot_be_read_is_refused() -> None:
    file = record()
    file.unlink()
    file.mkdir()  # permissions do not bind the tests of root

    with pytest.raises(RunError, match=r"fleet\.json: cannot be read: Is a directory"):
        remembered()


@pytest.mark.parametrize("data", [b"[]", b'{"eye": 3}', b'{"\xff": ""}'])
def test_damaged_addresses_are_refused(data: bytes, tmp_path: Path) -> None:
    (tmp_path / ADDRESSES).write_bytes(data)

    with pytest.raises(SettingsError, match=r"addresses\.json: expected label: address, got "):
        known_addresses(tmp_path)


def test_addresses_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / ADDRESSES).mkdir()

    with pytest.raises(SettingsError, match=r"addresses\.json: cannot be read: Is a directory"):
        known_addresses(tmp_path)
