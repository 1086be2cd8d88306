"""Looks at a square of the sensor through both streams."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.tracker.look import Streams
from pipeline import Frame
from pipeline.errors import MessageError
from pipeline.testing import header
from tests.operators.tracker.made_up import FIELD

NO_ROI = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))
NO_CONTEXT = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))


def ramp() -> np.ndarray:
    """Return a field whose red is x / 8 and whose green is y / 8."""
    y, x = np.mgrid[0:1080, 0:1920]
    return np.stack([x / 8, y / 8, 0 * x], -1).astype(np.uint8)


def centre_of(picture: np.ndarray) -> list[float]:
    """Return the sensor x and y in the middle of a look at `ramp`."""
    half = len(picture) // 2
    return (picture[half - 1 : half + 1, half - 1 : half + 1, :2].mean((0, 1)) * 8).tolist()


def part(whole: np.ndarray, window: tuple[int, int, int, int]) -> Frame:
    left, top, right, bottom = window
    return Frame(header=header(), pixels=whole[top:bottom, left:right], window=window)


def small(whole: np.ndarray) -> Frame:
    pixels = cv2.resize(whole, (480, 270), interpolation=cv2.INTER_AREA)
    return Frame(header=header(), pixels=pixels, window=FIELD)


def test_both_streams_show_the_same_place():
    whole, at = ramp(), np.array([801.0, 402.0], np.float32)

    through_context = Streams(context=small(whole), roi=NO_ROI).look(at, 160, 64)
    through_roi = Streams(context=NO_CONTEXT, roi=part(whole, (640, 270, 1120, 540))).look(
        at, 160, 64
    )

    assert centre_of(through_context) == pytest.approx([801, 402], abs=10)
    assert centre_of(through_roi) == pytest.approx([801, 402], abs=10)
    assert np.abs(through_context.astype(int) - through_roi).max() <= 2


def test_a_look_inside_the_roi_is_what_resizing_the_cut_gives():
    rng = np.random.default_rng(5)
    whole = rng.integers(0, 256, (1080, 1920, 3), np.uint8)
    expected = cv2.resize(whole[300:364, 700:764], (128, 128))

    streams = Streams(context=NO_CONTEXT, roi=part(whole, (640, 270, 1120, 540)))
    seen = streams.look(np.array([732, 332], np.float32), 64, 128)

    inner = np.s_[4:-4, 4:-4]
    assert np.abs(seen[inner].astype(int) - expected[inner]).max() <= 2


def test_the_roi_is_used_where_it_is_and_the_context_elsewhere():
    context = Frame(header=header(), pixels=np.full((270, 480, 3), 50, np.uint8), window=FIELD)
    roi = Frame(
        header=header(), pixels=np.full((270, 480, 3), 200, np.uint8), window=(0, 0, 480, 270)
    )

    seen = Streams(context=context, roi=roi).look(np.array([480, 135], np.float32), 100, 50)

    assert (seen[:, :24] == 200).all()
    assert (seen[:, 26:] == 50).all()


def test_outside_the_field_a_look_is_black():
    context = Frame(header=header(), pixels=np.full((270, 480, 3), 90, np.uint8), window=FIELD)

    seen = Streams(context=context, roi=NO_ROI).look(np.array([0, 500], np.float32), 200, 50)

    assert (seen[:, :23] == 0).all()
    assert (seen[:, 27:] == 90).all()


@pytest.mark.parametrize("depth", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("order", ["rggb", "grbg", "gbrg", "bggr"])
def test_a_mosaic_is_seen_in_colour(depth, order):
    mosaic = np.zeros((270, 480), np.uint16)
    row, column = divmod(order.index("r"), 2)
    mosaic[row::2, column::2] = 200 << (depth - 8)  # red sites only
    pixels = mosaic.astype(np.uint8) if depth == 8 else mosaic
    name = f"bayer_{order}{depth}"
    context = Frame(header=header(), pixels=pixels, window=FIELD, pixel_format=name)

    seen = Streams(context=context, roi=NO_ROI).look(np.array([901, 403], np.float32), 200, 32)

    red, green, blue = seen.mean((0, 1))
    assert red > 150
    assert green == blue == 0


def test_an_unknown_pixel_format_is_refused():
    frame = Frame(
        header=header(), pixels=np.zeros((9, 9), np.uint8), window=FIELD, pixel_format="yuv"
    )

    with pytest.raises(MessageError, match="got yuv"):
        Streams(context=frame, roi=NO_ROI).look(np.array([900, 500], np.float32), 900, 32)


def test_packed_bytes_are_refused_wherever_the_look_goes():
    packed = np.zeros((270, 720), np.uint8)
    frame = Frame(header=header(), pixels=packed, window=FIELD, pixel_format="bayer_rggb12p")

    for place in (np.array([900, 500], np.float32), np.array([-9000, 500], np.float32)):
        with pytest.raises(MessageError, match=r"got bayer_rggb12p; put operators.downsample"):
            Streams(context=frame, roi=NO_ROI).look(place, 900, 32)


@settings(max_examples=60, deadline=None)
@given(st.floats(-500, 2500), st.floats(-500, 1600), st.floats(2, 3000), st.sampled_from([32, 96]))
def test_any_square_can_be_looked_at(x, y, side, out):
    flat = np.full((1080, 1920, 3), 77, np.uint8)
    streams = Streams(context=small(flat), roi=part(flat, (480, 270, 960, 540)))

    seen = streams.look(np.array([x, y], np.float32), side, out)

    assert seen.shape == (out, out, 3)
    assert seen.max() <= 77


@pytest.mark.parametrize("before", [0, 7, 255])
def test_a_look_at_the_edge_of_the_roi_has_nothing_of_the_look_before(before: int):
    context = Frame(header=header(), pixels=np.full((270, 480, 3), 200, np.uint8), window=FIELD)
    roi = part(np.full((1080, 1920, 3), 200, np.uint8), (640, 270, 1120, 540))
    scratch = {128: np.full((128, 128, 3), before, np.uint8)}

    seen = Streams(context=context, roi=roi, scratch=scratch).look(
        np.array([672, 302], np.float32), 64, 128
    )

    assert (seen == 200).all()
