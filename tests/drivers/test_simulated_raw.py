"""The simulated sensor as a raw one: formats, orders, noise, settings."""

from typing import Any

import numpy as np
import pytest

from drivers.simulated import SimulatedSensorSettings
from drivers.simulated.readout import Readout
from pipeline.errors import SettingsError
from pipeline.pixel_formats import FORMATS
from tests.drivers.packing import numbers
from tests.drivers.test_simulated import play, sensor


@pytest.mark.parametrize("depth", ["10", "10p", "12", "12p", "14", "16"])
@pytest.mark.parametrize("order", ["rggb", "grbg", "gbrg", "bggr"])
def test_a_raw_sensor_sends_its_mosaic_in_the_format_asked_for(depth: str, order: str) -> None:
    name = f"bayer_{order}{depth}"
    (raw,) = play(sensor(mosaic=True, pixel_format=name, black_level=64, frames=1))
    (eight,) = play(sensor(mosaic=True, pixel_format=f"bayer_{order}8", frames=1))

    for got, plain in ((raw.context, eight.context), (raw.roi, eight.roi)):
        form = FORMATS[got.pixel_format]
        assert (form.name, got.size_px, got.window) == (name, plain.size_px, plain.window)
        levels = numbers(got.pixels, form)
        wanted = 64 + plain.pixels / 255 * (form.white - 64)
        assert np.abs(levels - wanted).max() <= 0.5 + 0.5 / (1 << 16 - form.bits)


def test_a_window_that_starts_at_odd_pixels_shows_the_sensors_mosaic_under_its_own_name() -> None:
    picture = np.random.default_rng(3).integers(0, 256, (24, 32, 3), np.uint8)
    readout = Readout(form=FORMATS["bayer_rggb8"], seed=0, most_px=32 * 24)
    whole = np.empty((24, 32), np.uint8)
    readout.read(picture, (0, 0, 32, 24), whole, seq=0, port=0)

    for left, top, name in ((1, 0, "grbg"), (0, 1, "gbrg"), (3, 5, "bggr"), (2, 4, "rggb")):
        window = (left, top, left + 12, top + 10)
        part = np.empty((10, 12), np.uint8)
        readout.read(picture, window, part, seq=0, port=1)

        assert readout.form_of(window, (12, 10)).order == name
        assert np.array_equal(part, whole[top : top + 10, left : left + 12])


def test_photon_noise_is_that_of_the_electrons_and_differs_from_frame_to_frame() -> None:
    options = {"mosaic": True, "pixel_format": "bayer_rggb12", "black_level": 200}
    noisy = play(sensor(**options, full_well_e=2000.0, read_noise_e=4.0, frames=6))
    quiet = play(sensor(**options, frames=6))

    per_number = 2000 / (4095 - 200)
    electrons = np.concatenate([(e.roi.pixels.ravel() - 200.0) for e in quiet]) * per_number
    seen = np.concatenate([(e.roi.pixels.ravel() - 200.0) for e in noisy]) * per_number
    middle = (electrons > 100) & (electrons < 1600)
    ratio = (seen - electrons)[middle] / np.sqrt(electrons[middle] + 16)
    assert middle.sum() > 5000
    assert ratio.std() == pytest.approx(1, abs=5 / np.sqrt(2 * middle.sum()))
    assert ratio.mean() == pytest.approx(0, abs=5 / np.sqrt(middle.sum()))
    assert not np.array_equal(noisy[0].roi.pixels, noisy[1].roi.pixels)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"full_well_e": 900.0}, "full_well_e: needs mosaic: true, got 900"),
        (
            {"mosaic": True, "pixel_format": "bayer_rgbg8"},
            "expected a mosaic, got bayer_rgbg8, did",
        ),
        ({"mosaic": True, "pixel_format": "rgb8"}, "pixel_format: expected a mosaic, got rgb8"),
        ({"mosaic": True, "black_level": 255}, "black_level: expected 0 to 254, got 255"),
        ({"mosaic": True, "read_noise_e": 2.0}, "read_noise_e: needs full_well_e"),
        ({"mosaic": True, "full_well_e": 0.5}, "full_well_e: expected 0 or at least 1, got 0.5"),
        ({"mosaic": True, "gamma": 0.0}, "gamma: expected 0.1 to 10, got 0.0"),
        ({"mosaic": True, "full_well_e": 900.0, "noise": 1.0}, "noise: expected 0 beside full_we"),
    ],
)
def test_settings_that_make_no_raw_sensor_are_refused(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        SimulatedSensorSettings(scene="soccer", **settings)
