"""Downsample: colour, size, and pictures that pass unchanged."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.mosaic import to_mosaic
from operators.downsample import Downsample, DownsampleSettings, fitted
from pipeline.errors import MessageError, SettingsError
from pipeline.messages import Frame
from pipeline.testing import drive, header, picture


def frame(pixels: NDArray[Any], pixel_format: str = "rgb8") -> Frame:
    return Frame(
        header=header(3),
        pixels=pixels,
        pixel_format=pixel_format,
        window=(0, 0, 1920, 1080),
        command_seq=2,
        status="unplanned",
    )


def smooth(height: int, width: int) -> NDArray[np.uint8]:
    """Return a picture without detail that a mosaic could lose."""
    rows, columns = np.mgrid[0:height, 0:width]
    channels = (rows * 100 / height, columns * 100 / width, 60 + columns * 50 / width)
    return np.stack(channels, -1).astype(np.uint8)


def mosaic_of(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    mosaic = np.empty(image.shape[:2], np.uint8)
    to_mosaic(image, "rggb", mosaic)
    return mosaic


def test_a_block_becomes_its_mean_and_the_rest_of_the_frame_stays() -> None:
    given_ = frame(picture(24, 48, seed=1))
    (got,) = drive(Downsample, [given_], {"width_px": 12})

    means = given_.pixels.reshape(6, 4, 12, 4, 3).mean(axis=(1, 3))
    assert np.abs(got.pixels - means).max() <= 0.5 + 1e-6
    assert (got.header, got.window) == (given_.header, given_.window)
    assert (got.command_seq, got.status) == (2, "unplanned")


@pytest.mark.parametrize("width_px", [0, 48, 64])
def test_a_picture_that_fits_passes_without_a_copy(width_px: int) -> None:
    given_ = frame(picture(24, 48, seed=1))

    (got,) = drive(Downsample, [given_], {"width_px": width_px})

    assert np.shares_memory(got.pixels, given_.pixels)
    assert got.pixels.shape == given_.pixels.shape


def test_an_empty_picture_passes() -> None:
    given_ = frame(np.empty((0, 0, 3), np.uint8))

    (got,) = drive(Downsample, [given_], {"width_px": 12})

    assert (got.pixels.shape, got.header) == ((0, 0, 3), given_.header)


def test_a_mosaic_becomes_the_picture_it_was_made_of() -> None:
    image = smooth(40, 60)

    (got,) = drive(Downsample, [frame(mosaic_of(image), "bayer_rggb8")])

    assert got.pixel_format == "rgb8"
    assert np.abs(got.pixels.astype(int) - image)[2:-2, 2:-2].max() <= 3


def test_sixteen_bits_become_eight() -> None:
    image = smooth(40, 60)
    mosaic = mosaic_of(image).astype(np.uint16) * 257

    (wide,) = drive(Downsample, [frame(mosaic, "bayer_rggb16")])
    (narrow,) = drive(Downsample, [frame(mosaic_of(image), "bayer_rggb8")])

    assert wide.pixels.dtype == np.uint8
    assert np.array_equal(wide.pixels, narrow.pixels)


def test_a_mosaic_can_be_shrunk_too() -> None:
    image = smooth(40, 60)

    (got,) = drive(Downsample, [frame(mosaic_of(image), "bayer_rggb8")], {"width_px": 15})

    means = image.reshape(10, 4, 15, 4, 3).mean(axis=(1, 3))
    assert got.pixels.shape == (10, 15, 3)
    assert np.abs(got.pixels - means)[1:-1, 1:-1].max() <= 3


def test_grey_becomes_rgb() -> None:
    grey = picture(12, 20, seed=2)[..., 0].copy()

    (got,) = drive(Downsample, [frame(grey, "grey8")])

    assert all(np.array_equal(got.pixels[..., c], grey) for c in range(3))


def test_the_result_lies_in_the_memory_of_its_output_and_the_input_may_be_read_only() -> None:
    lent: list[NDArray[Any]] = []

    def loan(
        output: str, shape: tuple[int, ...], dtype: Any, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        assert output == "out"
        lent.append(np.zeros(shape, dtype))
        return lent[-1]

    subject = Downsample(DownsampleSettings(width_px=12), loan=loan)
    subject.open()
    for pixels, form in (
        (picture(24, 48, seed=1), "rgb8"),
        (mosaic_of(smooth(24, 48)), "bayer_rggb8"),
    ):
        pixels.flags.writeable = False
        got = subject.on_frame(frame(pixels, form))
        assert got.pixels is lent[-1]
        assert got.pixels.any()


@given(height=st.integers(1, 10_000), width=st.integers(1, 20_000), width_px=st.integers(0, 5_000))
def test_it_never_enlarges_and_keeps_the_aspect(height: int, width: int, width_px: int) -> None:
    got_height, got_width = fitted((height, width), width_px)

    assert 1 <= got_height <= height
    assert 1 <= got_width <= width
    assert got_width <= (width_px or width)
    assert abs(got_height - height * got_width / width) <= 1


def test_an_unknown_pixel_format_is_refused() -> None:
    with pytest.raises(MessageError, match=r"frame: expected pixels as rgb8, .* got yuv422"):
        drive(Downsample, [frame(picture(4, 4, seed=0), "yuv422")])


def test_a_negative_width_is_refused() -> None:
    with pytest.raises(SettingsError, match="width_px: must be at least 0, got -1"):
        DownsampleSettings(width_px=-1)
