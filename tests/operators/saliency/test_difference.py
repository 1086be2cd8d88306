"""What changed between two pictures, without what the camera did."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency import MovedSaliency, Saliency
from operators.saliency.difference import FrameDifference
from operators.saliency.letterbox import Letterbox
from pipeline import Detections, Frame, WeightsError
from pipeline.testing import drive, header
from tests.operators.networks import changing_network, constant_network

Picture = NDArray[np.uint8]
SIZE_PX = (480, 270)


def scenery(seed: int = 1, size_px: tuple[int, int] = (560, 340)) -> Picture:
    """Smooth patches of all sizes: (h, w, 3)."""
    rng = np.random.default_rng(seed)
    whole = np.zeros((size_px[1], size_px[0], 3), np.float32)
    for cells in (8, 24, 70):
        coarse = rng.uniform(0, 1, (cells, cells, 3)).astype(np.float32)
        whole += cv2.resize(coarse, size_px, interpolation=cv2.INTER_CUBIC)
    return np.clip(40 + whole * 60, 0, 255).astype(np.uint8)


def seen(whole: Picture, left: float = 40, top: float = 35, turn_deg: float = 0.0) -> Picture:
    """What a camera shows of the scenery from a corner on."""
    width, height = SIZE_PX
    matrix = cv2.getRotationMatrix2D((left + width / 2, top + height / 2), turn_deg, 1.0)
    matrix[:, 2] -= (left, top)
    return np.asarray(cv2.warpAffine(whole, matrix, SIZE_PX), np.uint8)


def with_ball(picture: Picture, x: int, y: int) -> Picture:
    marked = picture.copy()
    cv2.circle(marked, (x, y), 3, (255, 255, 255), -1)
    return marked


@given(st.floats(-12, 12), st.floats(-6, 6), st.floats(-1, 1))
@settings(max_examples=25, deadline=None)
def test_a_camera_that_pans_and_turns_changes_little(x: float, y: float, turn: float) -> None:
    whole, difference = scenery(), FrameDifference()
    difference.of(seen(whole))

    found = difference.of(seen(whole, 40 + x, 35 + y, turn))

    assert np.abs(found[15:-15, 15:-15]).mean() < 1.5


@given(st.floats(-10, 10), st.floats(-5, 5))
@settings(max_examples=15, deadline=None)
def test_what_moves_by_itself_is_new_where_it_is_and_gone_where_it_was(x: float, y: float) -> None:
    whole, difference = scenery(2), FrameDifference()
    difference.of(with_ball(seen(whole), 200, 130))

    found = difference.of(with_ball(seen(whole, 40 + x, 35 + y), 240, 110))

    was = round(200 - x), round(130 - y)
    assert found[107:114, 237:244].max() > 60
    assert found[was[1] - 4 : was[1] + 5, was[0] - 4 : was[0] + 5].min() < -60


def test_a_first_picture_one_of_another_size_and_one_after_a_cut_tell_nothing() -> None:
    difference = FrameDifference()

    assert not difference.of(seen(scenery(1))).any()
    assert not difference.of(seen(scenery(5))).any()
    assert not difference.of(seen(scenery(5))[:200, :300]).any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 480), (480, 1), (2, 2000), (12, 40)])
def test_pictures_too_small_for_a_corner_tell_nothing(shape: tuple[int, int]) -> None:
    difference = FrameDifference()

    for level in (30, 200):
        assert not difference.of(np.full((*shape, 3), level, np.uint8)).any()


def test_two_empty_pictures_are_no_error() -> None:
    difference = FrameDifference()

    for level in (0, 90, 255):
        assert not difference.of(np.full((270, 480, 3), level, np.uint8)).any()


def test_of_a_fixed_camera_levels_are_subtracted_as_they_are() -> None:
    difference = FrameDifference(fixed=True)
    difference.of(np.full((20, 30), 90, np.uint8))

    assert (difference.of(np.full((20, 30), 30, np.uint8)) == -60).all()


def test_a_picture_whose_room_is_used_again_is_remembered() -> None:
    difference, room = FrameDifference(fixed=True), np.full((20, 30), 90, np.uint8)
    difference.of(room)
    room[:] = 100

    assert (difference.of(room) == 10).all()


def test_a_network_gets_the_change_as_a_share_of_white_in_a_fourth_plane() -> None:
    box = Letterbox(480, 288, scale=1 / 255, bgr=False, corner=False, difference=True)
    picture = np.zeros((270, 480, 3), np.uint8)

    box.put(picture, np.full((270, 480), -51, np.int16))

    assert box.tensor.shape == (1, 4, 288, 480)
    assert np.allclose(box.tensor[0, :, 100, 100], [0, 0, 0, -0.2])
    assert np.allclose(box.tensor[0, :, 4, 100], [114 / 255] * 3 + [0])  # beside the picture
    box.put(picture)
    assert not box.tensor[0, 3].any()


@pytest.mark.parametrize("operator", [Saliency, MovedSaliency])
def test_an_operator_tells_its_network_what_changed(
    tmp_path: Path, operator: type[Saliency] | type[MovedSaliency]
) -> None:
    weights = changing_network(tmp_path / "n.onnx")
    pictures = [seen(scenery()), seen(scenery()), with_ball(seen(scenery()), 240, 135)]
    frames = [
        Frame(header=header(k), pixels=pixels, window=(0, 0, 1920, 1080))
        for k, pixels in enumerate(pictures)
    ]

    found = drive(operator, frames, {"weights": weights, "confidence": 0.2})

    assert [len(answer.boxes) for answer in found if isinstance(answer, Detections)] == [0, 0, 1]


@pytest.mark.parametrize("operator", [Saliency, MovedSaliency])
@pytest.mark.parametrize(
    ("stream", "left", "found"), [("test", 0, 1), ("other", 0, 0), ("test", 80, 0)],
    ids=["the same", "another stream", "another window"],
)  # fmt: skip
def test_only_pictures_of_one_stream_and_one_window_are_compared(
    tmp_path: Path,
    operator: type[Saliency] | type[MovedSaliency],
    stream: str,
    left: int,
    found: int,
) -> None:
    weights = changing_network(tmp_path / "n.onnx")
    plain, marked = seen(scenery()), with_ball(seen(scenery()), 240, 135)
    frames = [
        Frame(header=header(0), pixels=plain, window=(0, 0, 1920, 1080)),
        Frame(header=header(1, stream=stream), pixels=marked, window=(left, 0, 1920 + left, 1080)),
    ]

    answers = drive(operator, frames, {"weights": weights, "confidence": 0.2})

    assert [len(a.boxes) for a in answers if isinstance(a, Detections)] == [0, found]


@pytest.mark.parametrize(
    ("planes", "said", "told"),
    [
        (3, "True", r"\(1, 4, height, width\), as its metadata says difference: True"),
        (4, "False", r"\(1, 3, height, width\), as its metadata does not say difference: True"),
        (3, "'yes'", r"metadata difference: expected True or False, got 'yes'"),
    ],
)
def test_weights_whose_metadata_contradict_their_input_are_refused(
    tmp_path: Path, planes: int, said: str, told: str
) -> None:
    output = np.zeros((1, 6, 64), np.float32)
    weights = constant_network(tmp_path / "n.onnx", output, planes=planes, difference=said)

    with pytest.raises(WeightsError, match=told):
        drive(Saliency, [], {"weights": weights})
