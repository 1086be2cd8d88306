"""Cutting whole pictures: every format becomes the RGB that a full conversion would give."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cameras.cutting import FORMATS, MOSAICS, Cutter
from pipeline.errors import DriverError
from tests.drivers.cameras.synthetic_camera import as_format, mosaic

SIZE_PX = (64, 48)


def scene(seed: int) -> np.ndarray:
    """Smooth colours (h, w, 3), so that a mosaic of them can be interpolated."""
    small = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), np.uint8)
    return np.asarray(cv2.resize(small, SIZE_PX, interpolation=cv2.INTER_LINEAR))


def grey(rgb: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB))


@pytest.mark.parametrize("pixel_format", [f for f in FORMATS if f not in MOSAICS])
@settings(max_examples=20)
@given(left=st.integers(0, 48), top=st.integers(0, 36), seed=st.integers(0, 99))
def test_an_roi_is_the_crop_in_rgb(pixel_format: str, left: int, top: int, seed: int) -> None:
    rgb, out = scene(seed), np.empty((12, 16, 3), np.uint8)
    window = (left, top, left + 16, top + 12)

    Cutter(pixel_format, SIZE_PX).roi(as_format(rgb, pixel_format), window, out)

    whole = grey(rgb) if pixel_format.startswith("grey") else rgb
    assert np.array_equal(out, whole[top : top + 12, left : left + 16])


@pytest.mark.parametrize("pixel_format", MOSAICS)
@settings(max_examples=20)
@given(left=st.integers(0, 24), top=st.integers(0, 18), seed=st.integers(0, 99))
def test_an_roi_of_a_mosaic_is_the_crop_of_its_colours(
    pixel_format: str, left: int, top: int, seed: int
) -> None:
    rgb, out = scene(seed), np.empty((12, 16, 3), np.uint8)
    left, top = 2 * left, 2 * top

    Cutter(pixel_format, SIZE_PX).roi(
        as_format(rgb, pixel_format), (left, top, left + 16, top + 12), out
    )

    codes = {
        "rggb": cv2.COLOR_BayerRGGB2RGB,
        "grbg": cv2.COLOR_BayerGRBG2RGB,
        "gbrg": cv2.COLOR_BayerGBRG2RGB,
        "bggr": cv2.COLOR_BayerBGGR2RGB,
    }
    order = pixel_format.removeprefix("bayer_")[:4]
    whole = cv2.cvtColor(mosaic(rgb, order), codes[order])
    assert np.array_equal(out, whole[top : top + 12, left : left + 16])
    assert np.abs(out.astype(int) - rgb[top : top + 12, left : left + 16]).mean() < 8


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_a_context_is_the_area_mean_in_rgb(pixel_format: str, seed: int) -> None:
    rgb, out = scene(seed), np.empty((12, 16, 3), np.uint8)

    Cutter(pixel_format, SIZE_PX).context(as_format(rgb, pixel_format), out)

    means = grey(rgb) if pixel_format.startswith("grey") else rgb
    wanted = cv2.resize(means, (16, 12), interpolation=cv2.INTER_AREA).astype(float)
    if pixel_format in MOSAICS:
        wanted = means_of_cells(rgb, pixel_format.removeprefix("bayer_")[:4])
    assert np.abs(out - wanted).max() <= 1


def means_of_cells(rgb: np.ndarray, order: str) -> np.ndarray:
    """Means over 4x4 pixels of those pixels that see the colour."""
    blocks = mosaic(rgb, order).reshape(12, 2, 2, 16, 2, 2)  # row, cell, row of it, column, …
    cells = blocks.mean(axis=(1, 4))  # (12, 2, 16, 2)
    places = {c: [divmod(p, 2) for p in range(4) if order[p] == c] for c in "rgb"}
    return np.stack(
        [np.mean([cells[:, y, :, x] for y, x in places[c]], axis=0) for c in "rgb"], axis=-1
    )


@pytest.mark.parametrize("pixel_format", FORMATS)
def test_a_smaller_read_out_is_the_area_mean_of_the_window(pixel_format: str) -> None:
    rgb, out = np.full((48, 64, 3), (200, 200, 200), np.uint8), np.empty((6, 8, 3), np.uint8)

    Cutter(pixel_format, SIZE_PX).roi(as_format(rgb, pixel_format), (4, 4, 20, 16), out)

    assert np.abs(out.astype(int) - 200).max() <= 1


@pytest.mark.parametrize("pixel_format", FORMATS)
def test_no_picture_of_full_size_is_made(pixel_format: str) -> None:
    pixels = as_format(np.zeros((480, 640, 3), np.uint8), pixel_format)
    cutter = Cutter(pixel_format, (640, 480))

    cutter.context(pixels, np.empty((120, 160, 3), np.uint8))
    cutter.roi(pixels, (320, 240, 480, 360), np.empty((120, 160, 3), np.uint8))

    sizes = [memory.shape[0] * memory.shape[1] for memory in cutter._scratch.values()]
    assert max(sizes, default=0) <= (120 + 4) * (160 + 4)


@pytest.mark.parametrize(
    ("pixel_format", "size_px", "said"),
    [
        ("yuyv", (64, 48), "expected rgb8, bgr8, grey8"),
        ("rgb8", (0, 48), "expected sides of at least 1, got 0x48"),
        ("bayer_rggb8", (63, 48), "a mosaic needs even sides of at least 4, got 63x48"),
    ],
)
def test_what_cannot_be_cut_is_refused(
    pixel_format: str, size_px: tuple[int, int], said: str
) -> None:
    with pytest.raises(DriverError, match=said):
        Cutter(pixel_format, size_px)


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((48, 65, 3), np.uint8),
        np.zeros((48, 64), np.uint8),
        np.zeros((48, 64, 3), np.uint16),
        np.zeros((0, 0, 3), np.uint8),
    ],
)
def test_a_picture_that_was_not_negotiated_is_refused(pixels: np.ndarray) -> None:
    with pytest.raises(DriverError, match="expected bgr8 of 64x48 as at the start, got"):
        Cutter("bgr8", SIZE_PX).check(pixels)
