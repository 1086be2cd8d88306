"""Pictures from files: whole, RGB, all of one size."""

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.datasets.images import ImageFolder
from drivers.datasets.pictures import read_picture
from pipeline.errors import DriverError
from tests.drivers.sequences import write_pictures


def test_pictures_come_in_order_of_name(tmp_path: Path) -> None:
    write_pictures(tmp_path, 4, suffix=".png")
    (tmp_path / "notes.txt").write_text("not a picture")
    folder = ImageFolder(path=str(tmp_path))

    means = [folder.picture(k).mean() for k in range(4)]
    assert np.allclose(np.diff(means), 10)
    assert (folder.length, folder.size_px) == (4, (64, 48))
    with pytest.raises(IndexError):
        folder.picture(4)


def test_colours_are_red_green_blue(tmp_path: Path) -> None:
    blue_green_red = np.zeros((4, 4, 3), np.uint8)
    blue_green_red[..., 2] = 200
    cv2.imwrite(str(tmp_path / "red.png"), blue_green_red)

    assert read_picture(tmp_path / "red.png")[0, 0].tolist() == [200, 0, 0]


def test_a_picture_is_decoded_into_the_memory_given(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1)
    memory = np.zeros((48, 64, 3), np.uint8)

    found = read_picture(tmp_path / "000001.jpg", memory)

    assert np.shares_memory(found, memory)
    assert memory.mean() > 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(cut=st.integers(1, 400), suffix=st.sampled_from([".jpg", ".png"]))
def test_a_picture_cut_off_anywhere_is_an_error_that_names_it(
    tmp_path: Path, cut: int, suffix: str
) -> None:
    write_pictures(tmp_path, 1, suffix=suffix)
    whole = (tmp_path / f"000001{suffix}").read_bytes()
    end = 8 if suffix == ".png" else 2  # without its checksum the last chunk of a PNG still counts
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[: max(0, len(whole) - end - cut)])

    with pytest.raises(DriverError, match=rf"cut\{suffix}: .* truncated"):
        read_picture(path)


def test_padding_after_the_end_is_allowed(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1)
    path = tmp_path / "000001.jpg"
    path.write_bytes(path.read_bytes() + bytes(512))

    assert read_picture(path).shape == (48, 64, 3)


def test_a_file_that_is_no_picture_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.bmp").write_bytes(b"hello")

    with pytest.raises(DriverError, match=r"a\.bmp: expected a picture"):
        ImageFolder(path=str(tmp_path))


def test_a_picture_of_another_size_is_named(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1, suffix=".png")
    cv2.imwrite(str(tmp_path / "z.png"), np.zeros((10, 20, 3), np.uint8))
    folder = ImageFolder(path=str(tmp_path))

    with pytest.raises(DriverError, match=r"z\.png: expected 64x48 .* got 20x10"):
        folder.picture(1)


def stating(width: int, height: int) -> bytes:
    """Return a PNG that states a size and has no pixels."""

    def chunk(name: bytes, data: bytes) -> bytes:
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


@pytest.mark.parametrize("size_px", [(32_769, 2), (2, 40_000), (32_000, 9000)])
def test_a_picture_that_is_too_large_is_refused_by_its_header(
    tmp_path: Path, size_px: tuple[int, int]
) -> None:
    (tmp_path / "a.png").write_bytes(stating(*size_px))

    with pytest.raises(DriverError, match=rf"a\.png: .*at most 32768 .* got {size_px[0]}x"):
        read_picture(tmp_path / "a.png")


def test_the_size_of_another_picture_is_named_without_decoding_it(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(stating(14_000, 14_000))

    with pytest.raises(DriverError, match="expected 64x48 like the pictures before, got 14000x"):
        read_picture(tmp_path / "a.png", np.empty((48, 64, 3), np.uint8))


@pytest.mark.parametrize("data", [b"hello IEND", stating(64, 48)])
def test_the_picture_before_is_not_taken_for_one_that_cannot_be_decoded(
    tmp_path: Path, data: bytes
) -> None:
    (tmp_path / "a.png").write_bytes(data)

    with pytest.raises(DriverError, match=r"a\.png: expected a picture"):
        read_picture(tmp_path / "a.png", np.full((48, 64, 3), 99, np.uint8))


def test_a_name_that_is_no_utf_8_is_read_and_shown(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1)
    name = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.jpg"))
    (tmp_path / "000001.jpg").rename(name)
    name.with_suffix(".png").write_bytes(b"cut")

    assert read_picture(name).shape == (48, 64, 3)
    with pytest.raises(DriverError, match=r"\\udcff\.png: .* truncated"):
        read_picture(name.with_suffix(".png"))


def test_a_picture_turned_by_its_camera_is_of_the_size_that_is_shown(tmp_path: Path) -> None:
    write_pictures(tmp_path, 1)
    turned = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06" + bytes(6)
    path = tmp_path / "000001.jpg"
    data = path.read_bytes()
    length = (len(turned) + 2).to_bytes(2, "big")
    path.write_bytes(data[:2] + b"\xff\xe1" + length + turned + data[2:])

    assert read_picture(path, np.empty((64, 48, 3), np.uint8)).shape == (64, 48, 3)
    with pytest.raises(DriverError, match=r"expected 64x48 .*, got 48x64"):
        read_picture(path, np.empty((48, 64, 3), np.uint8))


def test_an_empty_or_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="expected pictures"):
        ImageFolder(path=str(tmp_path))
    with pytest.raises(DriverError, match="no such folder"):
        ImageFolder(path=str(tmp_path / "nowhere"))
    with pytest.raises(DriverError, match="cannot be read: No such file"):
        read_picture(tmp_path / "nowhere.jpg")
