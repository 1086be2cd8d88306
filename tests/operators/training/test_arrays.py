"""Files of arrays: those made with other settings, or damaged, are made anew."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.training.arrays import mapped, outdated, read, write
from pipeline.errors import DriverError
from tests.full_disk import full_disk

MADE = {"frames": "80", "saliency.weights": "1f"}


def kept(folder: Path, **made: str) -> Path:
    path = folder / "7.npz"
    write(path, {"a": np.arange(500)}, MADE | made)
    return path


def test_a_written_file_is_read_back_and_is_the_only_one(tmp_path: Path) -> None:
    path = kept(tmp_path)

    assert outdated([path], MADE, pytest.fail) == []
    assert {name: values.tolist() for name, values in read(path).items()} == {"a": list(range(500))}
    assert list(tmp_path.iterdir()) == [path]


def test_the_settings_that_differ_are_named(tmp_path: Path) -> None:
    path, said = kept(tmp_path, frames="2", more="1"), list[str]()

    assert outdated([path, tmp_path / "8.npz"], MADE, said.append) == [path, tmp_path / "8.npz"]
    assert said == [f"{tmp_path}: made anew: other frames, more (1 file)"]


def damaged(path: Path, how: str) -> None:
    whole = path.read_bytes()
    if how == "empty":
        path.write_bytes(b"")
    elif how == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif how == "bent":  # in the middle of the numbers
        path.write_bytes(whole[:800] + b"\xff" * 8 + whole[808:])
    elif how == "text":
        path.write_text("nothing")
    elif how == "one array":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))


@pytest.mark.parametrize("how", ["empty", "cut", "bent", "text", "one array"])
def test_a_damaged_file_is_made_anew_or_refused(tmp_path: Path, how: str) -> None:
    path, said = kept(tmp_path), list[str]()
    damaged(path, how)

    assert outdated([path], MADE, said.append) == [path]
    assert f"{path}: expected arrays, got " in said[0]
    with pytest.raises(DriverError, match=r"7\.npz: expected arrays, got "):
        read(path)


def test_a_file_of_an_earlier_version_is_made_anew(tmp_path: Path) -> None:
    path, said = tmp_path / "7.npz", list[str]()
    np.savez(path, other=np.zeros(3))

    assert outdated([path], MADE, said.append) == [path]
    assert said == [f"{tmp_path}: made anew: by an earlier version (1 file)"]


@pytest.mark.parametrize("how", ["missing", "empty", "cut"])
def test_a_file_whose_pictures_are_damaged_is_made_anew(tmp_path: Path, how: str) -> None:
    path, said = kept(tmp_path), list[str]()
    beside = tmp_path / "7.npy"
    np.save(beside, np.zeros((4, 9, 9), np.uint8))
    assert outdated([path], MADE, pytest.fail, with_pictures=True) == []
    whole = beside.read_bytes()
    beside.unlink()
    if how != "missing":
        beside.write_bytes(whole[: len(whole) // 2] if how == "cut" else b"")

    assert outdated([path], MADE, said.append, with_pictures=True) == [path]
    assert f"{beside}: expected pictures, got " in said[0]


def test_what_files_were_made_of_may_differ(tmp_path: Path) -> None:
    path, said = kept(tmp_path, source="a"), list[str]()

    assert outdated([path], lambda _: MADE | {"source": "a"}, pytest.fail) == []
    assert outdated([path], lambda _: MADE | {"source": "b"}, said.append) == [path]


def shown(value: int) -> NDArray[np.uint8]:
    return np.full((2, 3, 4), value, np.uint8)


def test_a_training_keeps_the_pictures_that_another_one_replaces(tmp_path: Path) -> None:
    path = tmp_path / "7.npz"
    write(path, {"a": np.arange(2)}, MADE, shown(1))
    in_use = mapped(path)

    write(path, {"a": np.arange(2)}, MADE | {"frames": "2"}, shown(2)[:1])

    assert np.array_equal(in_use, shown(1))
    assert np.array_equal(mapped(path), shown(2)[:1])


def test_pictures_without_the_arrays_that_belong_to_them_are_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "7.npz"
    write(path, {"a": np.arange(2)}, MADE, shown(1))

    with pytest.raises(OSError, match=r"7\.npz"), full_disk(2000):  # the new pictures fit
        write(path, {"a": np.arange(500)}, MADE | {"frames": "2"}, shown(2))

    assert outdated([path], MADE, pytest.fail, with_pictures=True) == [path]


def test_a_disk_without_room_for_pictures_is_told_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"File too large: .*7\.npy"), full_disk(2000):
        write(tmp_path / "7.npz", {}, MADE, np.zeros((99, 99), np.uint8))
