"""ALOHA episodes: what is written is read, and files that are damaged or others are refused."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

h5py = pytest.importorskip("h5py", reason="needs the robot extra")

from drivers.datasets import AlohaEpisode, VideoFile  # noqa: E402
from drivers.datasets.aloha import write_episode  # noqa: E402
from pipeline.errors import DriverError  # noqa: E402
from tests.shared_data import Footage  # noqa: E402

FRAMES = 5


def episode(folder: Path, **changes: Any) -> Path:
    random = np.random.default_rng(3)
    path = folder / "episode_0.hdf5"
    values = {
        "pictures": {"top": random.integers(0, 255, (FRAMES, 12, 16, 3), np.uint8)},
        **{n: random.random((FRAMES, 14), np.float32) for n in ("qpos", "qvel", "action")},
    }
    write_episode(path, **(values | changes))
    return path


def test_an_episode_is_read_as_it_was_written(tmp_path: Path) -> None:
    shown = np.random.default_rng(1).integers(0, 255, (FRAMES, 12, 16, 3), np.uint8)
    action = np.random.default_rng(2).random((FRAMES, 14), np.float32)

    read = AlohaEpisode(path=str(episode(tmp_path, pictures={"top": shown}, action=action)))

    assert (read.size_px, read.rate_hz, read.length, read.simulated) == ((16, 12), 50, FRAMES, True)
    np.testing.assert_array_equal(read.picture(3), shown[3])
    np.testing.assert_array_equal(read.action, action)
    with pytest.raises(IndexError):
        read.picture(FRAMES)
    read.close()


def test_a_file_cut_short_anywhere_is_one_sentence(tmp_path: Path) -> None:
    whole = episode(tmp_path).read_bytes()
    cut = tmp_path / "cut.hdf5"

    for share in np.linspace(0, 0.99, 12):
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DriverError, match=r"cut\.hdf5") as refused:
            AlohaEpisode(path=str(cut))
        assert "\n" not in str(refused.value)


def test_bytes_that_were_changed_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    whole, random = episode(tmp_path).read_bytes(), np.random.default_rng(5)
    path = tmp_path / "changed.hdf5"

    for _ in range(60):
        damaged = bytearray(whole)
        for at in random.integers(0, len(whole), 20):
            damaged[at] = int(random.integers(256))
        path.write_bytes(damaged)
        with suppress(DriverError):  # anything else fails the test
            read = AlohaEpisode(path=str(path))
            read.picture(FRAMES - 1)
            read.close()


def with_link(path: Path, name: str, link: Any) -> None:
    with h5py.File(path, "a") as file:
        del file[name]
        file[name] = link


@pytest.mark.parametrize("name", ["action", "observations", "observations/images/top"])
@pytest.mark.parametrize("kind", ["external", "soft"])
def test_an_episode_that_leads_elsewhere_is_refused(tmp_path: Path, name: str, kind: str) -> None:
    path = episode(tmp_path)
    (tmp_path / "other").mkdir()
    other = episode(tmp_path / "other")
    link = h5py.ExternalLink(str(other), name) if kind == "external" else h5py.SoftLink("/action")
    with_link(path, name, link)

    with pytest.raises(DriverError, match=f"{name}: expected data in the file, got a link"):
        AlohaEpisode(path=str(path))


def test_numbers_in_other_files_are_refused(tmp_path: Path) -> None:
    path, raw = episode(tmp_path), tmp_path / "raw"
    raw.write_bytes(bytes(FRAMES * 14 * 4))
    with h5py.File(path, "a") as file:
        del file["action"]
        file.create_dataset(
            "action", shape=(FRAMES, 14), dtype="f4", external=[(str(raw), 0, FRAMES * 14 * 4)]
        )

    with pytest.raises(DriverError, match="action: expected numbers in the file"):
        AlohaEpisode(path=str(path))


def test_virtual_numbers_are_refused(tmp_path: Path) -> None:
    path = episode(tmp_path)
    (tmp_path / "other").mkdir()
    other = episode(tmp_path / "other")
    layout = h5py.VirtualLayout((FRAMES, 14), "f4")
    layout[:] = h5py.VirtualSource(str(other), "action", (FRAMES, 14))
    with h5py.File(path, "a") as file:
        del file["action"]
        file.create_virtual_dataset("action", layout)

    with pytest.raises(DriverError, match="action: expected numbers in the file"):
        AlohaEpisode(path=str(path))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"action": np.zeros((FRAMES - 1, 14), np.float32)}, "action: expected"),
        ({"qvel": np.zeros((FRAMES, 13), np.float32)}, "qvel: expected"),
        ({"qpos": np.zeros(FRAMES, np.float32)}, r"qpos: expected \(T, n\) numbers"),
        ({"qpos": np.full((FRAMES, 14), np.inf, np.float32)}, "finite"),
        ({"pictures": {"left": np.zeros((FRAMES, 4, 4, 3), np.uint8)}}, "expected one of left"),
        ({"pictures": {"top": np.zeros((2, 4, 4, 3), np.uint8)}}, "expected 5 pictures, got 2"),
        ({"pictures": {"top": np.zeros((FRAMES, 4, 4, 3), np.float32)}}, "uint8"),
    ],
)
def test_parts_that_do_not_fit_one_another_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(DriverError, match=words):
        AlohaEpisode(path=str(episode(tmp_path, **changes)))


QPOS, TOP = "observations/qpos", "observations/images/top"


@pytest.mark.parametrize(
    ("name", "made", "words"),
    [
        (QPOS, {"shape": (FRAMES, 200_000), "dtype": "f4"}, "at most 256 columns, got 200000"),
        (
            QPOS,
            {"shape": (FRAMES, 14), "maxshape": (None, None), "chunks": (1 << 16, 1 << 12),
             "dtype": "f4"},
            "expected chunks of at most",
        ),
        (QPOS, {"data": h5py.Empty("f4")}, "qpos: expected numbers, got none"),
        (TOP, {"data": h5py.Empty("u1")}, "top: expected numbers, got none"),
        (TOP, {"shape": (FRAMES, 40_000, 8, 3), "dtype": "u1"}, "top: .* got 8x40000"),
        (TOP, {"shape": (FRAMES, 20_000, 20_000, 3), "dtype": "u1"}, "top: .* got 20000x20000"),
        (TOP, {"shape": (FRAMES, 0, 8, 3), "dtype": "u1"}, "top: expected pictures, got empty"),
    ],
)  # fmt: skip
def test_parts_that_are_too_large_or_empty_are_refused(
    tmp_path: Path, name: str, made: dict[str, Any], words: str
) -> None:
    path = episode(tmp_path)
    with h5py.File(path, "a") as file:
        del file[name]
        file.create_dataset(name, **({} if "data" in made else {"chunks": True}) | made)

    with pytest.raises(DriverError, match=words):
        AlohaEpisode(path=str(path))


def test_a_type_and_an_attribute_of_several_values_are_refused(tmp_path: Path) -> None:
    path = episode(tmp_path)
    with h5py.File(path, "a") as file:
        del file[QPOS]
        file[QPOS] = np.dtype("f4")

    with pytest.raises(DriverError, match="qpos: expected numbers, got none"):
        AlohaEpisode(path=str(path))
    with h5py.File(path, "a") as file:
        file.attrs["sim"] = [1, 0]
    with pytest.raises(DriverError, match="sim: expected true or false"):
        AlohaEpisode(path=str(path))


@pytest.mark.parametrize("name", ["action", "observations/qpos", "observations/images"])
def test_a_part_that_is_missing_is_named(tmp_path: Path, name: str) -> None:
    path = episode(tmp_path)
    with h5py.File(path, "a") as file:
        del file[name]

    with pytest.raises(DriverError, match=f"expected {name}, got none"):
        AlohaEpisode(path=str(path))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="no such file"):
        AlohaEpisode(path=str(tmp_path / "none.hdf5"))


@pytest.mark.footage
@pytest.mark.parametrize(("kind", "steps"), [("scripted", 400), ("human", 500)])
def test_a_real_episode_is_read_as_it_was_recorded(
    footage: Footage, tmp_path: Path, kind: str, steps: int
) -> None:
    folder = footage.data("aloha")
    with np.load(folder / f"{kind}_episode0.npz") as real:
        qpos, action = (np.asarray(real[name], np.float32) for name in ("qpos", "action"))
    video = VideoFile(path=str(folder / f"{kind}_top.mp4"))
    first = video.picture(0).copy()
    shown = np.broadcast_to(first, (steps, *first.shape))  # the same bytes: they compress well
    path = episode(tmp_path, pictures={"top": shown}, qpos=qpos, qvel=qpos * 0, action=action)

    read = AlohaEpisode(path=str(path))

    assert (read.size_px, read.rate_hz, read.length) == ((640, 480), video.rate_hz, steps)
    np.testing.assert_array_equal(read.picture(steps - 1), first)
    np.testing.assert_array_equal(read.qpos, qpos)
    np.testing.assert_array_equal(read.action, action)
    read.close()
    video.close()
