"""Video files: the same pictures in any order of access."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.datasets.video import VideoFile
from pipeline.errors import DriverError
from tests.shared_data import Footage

FRAMES = 90
SIZE_PX = (192, 64)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, SIZE_PX)
    for k in range(FRAMES):
        picture = np.zeros((SIZE_PX[1], SIZE_PX[0], 3), np.uint8)
        picture[:, : 2 * k + 1, 1:] = 255  # the width of a yellow bar encodes the frame number
        writer.write(picture)
    writer.release()
    return path


def number_of(picture: NDArray[np.uint8]) -> int:
    bar = (picture[..., :2].mean(axis=(0, 2)) > 128).sum()
    return round((float(bar) - 1) / 2)


def test_frames_read_in_order_are_all_there(film: Path) -> None:
    video = VideoFile(path=str(film))

    assert (video.length, video.size_px, video.rate_hz) == (FRAMES, SIZE_PX, 25.0)
    assert [number_of(video.picture(k)) for k in range(FRAMES)] == list(range(FRAMES))
    with pytest.raises(IndexError):
        video.picture(FRAMES)
    video.close()


def test_frames_are_the_same_in_any_order(film: Path) -> None:
    video = VideoFile(path=str(film))
    order = [5, 5, 6, 3, 80, 0, 89, 10, 40]

    assert [number_of(video.picture(k)) for k in order] == order
    video.close()


def test_colours_are_red_green_blue(film: Path) -> None:
    video = VideoFile(path=str(film))

    red, green, blue = video.picture(60).reshape(-1, 3).mean(axis=0)
    assert min(red, green) > blue + 100
    video.close()


def test_a_name_that_is_no_utf_8_is_read(film: Path) -> None:
    name = Path(os.fsdecode(os.fsencode(film.parent) + b"/\xff.mp4"))
    name.symlink_to(film)

    video = VideoFile(path=str(name))

    assert number_of(video.picture(40)) == 40
    video.close()


def test_a_file_that_is_no_video_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"not a film")

    with pytest.raises(DriverError, match=r"a\.mp4: expected a video"):
        VideoFile(path=str(tmp_path / "a.mp4"))
    with pytest.raises(DriverError, match=r"b\.mp4: expected a video file, got no such file"):
        VideoFile(path=str(tmp_path / "b.mp4"))


@pytest.mark.footage
def test_a_real_film_reads_to_its_end(footage: Footage) -> None:
    video = VideoFile(path=str(footage.data("street/street_720p.mp4")))

    assert video.length is not None
    assert video.length >= 150
    assert video.picture(video.length - 1).shape == (720, 1280, 3)
    video.close()


def test_a_folder_in_the_place_of_a_video_is_called_one(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=f"^{tmp_path}: expected a video file, got a folder$"):
        VideoFile(path=str(tmp_path))
