"""The pixel formats of the USB board: which one is used, and what its frames hold."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.mosaic import to_mosaic
from drivers.noise import Response
from drivers.usb import DualStreamBoardSettings
from drivers.usb.board_settings import known_formats, pixel_format
from drivers.virtual_board.profiles import PROFILES
from pipeline.errors import DriverError, SettingsError
from pipeline.pixel_formats import FORMATS
from tests.drivers.contract import command, read, started
from tests.drivers.moving_square import MovingSquare
from tests.drivers.packing import numbers
from tests.drivers.usb.boards import board, played

BOARDS = "tests.drivers.usb.boards"


@pytest.mark.parametrize("depth", ["10", "10p", "12", "12p", "14", "16"])
def test_raw_frames_hold_the_samples_of_the_mosaic_that_the_board_sent(depth: str) -> None:
    form = FORMATS[f"bayer_rggb{depth}"]
    raw = played(board(virtual={"frames": 2}, pixel_format=form.name))[1]
    eight = played(board(virtual={"frames": 2}, pixel_format="bayer_rggb8"))[1]

    for got, plain in ((raw.context, eight.context), (raw.roi, eight.roi)):
        assert (got.pixel_format, got.packed) == (form.name, depth.endswith("p"))
        assert (got.size_px, got.window) == (plain.size_px, plain.window)
        assert (got.pixels.dtype, got.pixels.shape) == (form.dtype, form.shape(plain.size_px))
        levels = numbers(got.pixels, form)
        assert np.abs(levels - plain.pixels / 255 * form.white).max() <= 1


def test_a_raw_window_at_odd_pixels_is_named_by_its_own_first_pixel() -> None:
    subject = started(board(backend=f"{BOARDS}:StepOneBackend", pixel_format="bayer_rggb12p"))
    seen = read(subject).header
    windows = [(3, 0, 83, 48), (2, 5, 82, 53), (7, 9, 87, 57)]
    subject.set_rois(command(seen.stream, made_from=seen.seq, first=seen.seq + 1, windows=windows))

    exposures = [read(subject) for _ in windows]

    subject.close()
    picture = MovingSquare()
    orders = []
    for exposure, window in zip(exposures, windows, strict=True):
        assert exposure.roi.window == window
        assert exposure.context.pixel_format == "bayer_rggb12p"
        form = FORMATS[exposure.roi.pixel_format]
        orders.append(form.order)
        left, top, right, bottom = window
        shown = picture.picture(exposure.header.seq)[top:bottom, left:right]
        mosaic = np.empty(shown.shape[:2], np.uint8)
        to_mosaic(shown, form.order, mosaic)
        assert np.abs(numbers(exposure.roi.pixels, form) - mosaic / 255 * 4095).max() <= 1
    assert orders == ["grbg", "gbrg", "bggr"]


def test_a_frame_of_a_format_that_was_not_asked_for_is_an_error_of_the_board() -> None:
    subject = board(backend=f"{BOARDS}:MislabelledBackend", pixel_format="bayer_rggb12")

    with pytest.raises(DriverError, match="expected bayer_rggb12 as configured, got grey12"):
        played(subject)


@pytest.mark.parametrize(
    ("codes", "names"),
    [
        ((0x0110002F, 0x01080009), ["bayer_rggb16", "bayer_rggb8"]),
        ((0x01080009, 0x02180014, 0x12345678), ["rgb8", "bayer_rggb8"]),
    ],
)
def test_the_format_is_rgb_or_else_the_first_known_one_that_the_board_lists(
    codes: tuple[int, ...], names: list[str]
) -> None:
    can = replace(PROFILES["ideal"].can, formats=codes)

    assert [form.name for form in known_formats(can)] == names
    assert pixel_format(DualStreamBoardSettings(), can).name == names[0]


def test_a_board_without_a_known_format_is_refused_with_its_codes() -> None:
    can = replace(PROFILES["ideal"].can, formats=(0x12345678,))

    with pytest.raises(SettingsError, match=r"one of pipeline\.pixel_formats, got 0x12345678"):
        pixel_format(DualStreamBoardSettings(), can)


def test_a_name_of_genicam_is_answered_with_ours() -> None:
    with pytest.raises(SettingsError, match="got BayerRG12p, here called bayer_rggb12p"):
        board(pixel_format="BayerRG12p")


def test_a_virtual_sensor_counts_photons_and_has_noise_as_its_settings_say() -> None:
    light = {"black_level": 256, "full_well_e": 2000.0, "read_noise_e": 5.0, "gamma": 2.2}
    noisy = played(board(virtual={"frames": 2, **light}, pixel_format="bayer_rggb12p"))[1].roi
    eight = played(board(virtual={"frames": 2}, pixel_format="bayer_rggb8"))[1].roi
    response = Response(bits=12, **light)  # type: ignore[arg-type]

    levels = eight.pixels.astype(np.float64)
    found = numbers(noisy.pixels, FORMATS["bayer_rggb12p"])
    apart = (found - response.mean(levels)) / response.deviation(levels)

    assert abs(apart[levels < 250].mean()) < 0.1  # white is clipped
    assert 0.9 < apart[levels < 250].std() < 1.1


def test_noise_of_photons_is_refused_for_pictures_that_are_no_mosaic() -> None:
    with pytest.raises(DriverError, match=r"expected a mosaic with full_well_e, .* got rgb8"):
        played(board(virtual={"full_well_e": 2000.0}))


def test_two_kinds_of_noise_at_once_are_refused() -> None:
    with pytest.raises(SettingsError, match="noise: expected 0 beside full_well_e"):
        played(board(virtual={"full_well_e": 2000.0, "noise": 2.0}))
