"""What streams need: bytes of every format with the padding of rows, rates, what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import MessageError, SettingsError
from pipeline.forecast import Forecast, PictureStream, pictures
from pipeline.pixel_formats import FORMATS, PixelFormat

FORMS = st.sampled_from(list(FORMATS.values()))
SIDES = st.integers(1, 20_000)


@given(form=FORMS, width=SIDES, height=SIDES)
def test_a_picture_has_the_bytes_of_its_array_and_each_row_begins_at_a_byte(
    form: PixelFormat, width: int, height: int
) -> None:
    stream = pictures((width, height), form.name, 30)

    assert (
        stream.frame_bytes == math.prod(form.shape((width, height))) * np.dtype(form.dtype).itemsize
    )
    bits = width * form.channels * (form.bits if form.packed else 8 * np.dtype(form.dtype).itemsize)
    padding = stream.frame_bytes * 8 - bits * height
    assert 0 <= padding < 8 * height
    assert padding % height == 0


@given(form=FORMS, width=SIDES, height=SIDES, rate_hz=st.floats(0.01, 10_000))
def test_bytes_a_second_are_those_of_a_picture_times_the_rate(
    form: PixelFormat, width: int, height: int, rate_hz: float
) -> None:
    stream = pictures((width, height), form.name, rate_hz)

    assert stream.frame_bytes is not None
    assert stream.bytes_per_s == pytest.approx(stream.frame_bytes * rate_hz)


def test_what_is_not_known_makes_nothing_up() -> None:
    compressed = PictureStream(
        size_px=(640, 480), pixel_format="MJPG", frame_bytes=None, rate_hz=30
    )

    assert compressed.bytes_per_s is None
    assert pictures((640, 480), "rgb8").bytes_per_s is None


def test_a_stream_without_pictures_needs_nothing_whatever_its_rate() -> None:
    assert pictures((0, 0), "bayer_rggb12p").bytes_per_s == 0


def test_an_unknown_format_is_refused_by_name() -> None:
    with pytest.raises(MessageError, match="got yuv7"):
        pictures((4, 4), "yuv7", 30)


@pytest.mark.parametrize("rate_hz", [-1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate_hz: float) -> None:
    with pytest.raises(SettingsError, match="rate_hz: expected a number from 0 on"):
        pictures((4, 4), "rgb8", rate_hz)
    with pytest.raises(SettingsError, match="rate_hz: expected a number from 0 on"):
        Forecast(rate_hz=rate_hz)


def test_sides_below_none_are_refused() -> None:
    with pytest.raises(SettingsError, match="size_px: expected sides and bytes from 0 on"):
        PictureStream(size_px=(-1, 4), pixel_format="rgb8", frame_bytes=0)


def test_a_delay_below_none_is_refused() -> None:
    with pytest.raises(SettingsError, match="readout_frames: expected a number from 0 on, got -1"):
        Forecast(readout_frames=-1)
