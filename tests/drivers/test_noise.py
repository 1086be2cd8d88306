"""Photon and read noise: the statistics of a sensor's numbers."""

import numpy as np
import pytest

from drivers.noise import Response, normal_table, stretch
from pipeline.errors import SettingsError

PIXELS = 400, 500  # of one level


def seen(response: Response, level: int, seed: int) -> np.ndarray:
    picture = np.full(PIXELS, level, np.uint8)
    return response.expose(picture, normal_table(picture.size, seed).reshape(PIXELS)).astype(float)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("seed", [1, 2])
def test_variance_grows_with_the_mean_as_photons_do(bits, seed):
    response = Response(bits=bits, black_level=(1 << bits) // 16, full_well_e=4000, read_noise_e=12)
    per_number, count = response.electrons_per_number, PIXELS[0] * PIXELS[1]

    for level in (0, 16, 64, 128, 192):
        numbers = seen(response, level, seed)
        wanted_mean = response.mean(np.array([float(level)]))[0]
        electrons = (wanted_mean - response.black_level) * per_number
        wanted = (electrons + 12**2) / per_number**2 + 1 / 12  # numbers are rounded
        # five standard deviations of a variance and of a mean over so many pixels
        assert numbers.var() == pytest.approx(wanted, rel=5 * np.sqrt(2 / count) + 0.004)
        assert numbers.mean() == pytest.approx(wanted_mean, abs=5 * np.sqrt(wanted / count) + 0.01)


def test_noise_goes_below_the_black_level_and_never_beyond_the_range():
    response = Response(bits=10, black_level=20, full_well_e=500, read_noise_e=8)

    dark, full = seen(response, 0, 3), seen(response, 255, 3)

    assert dark.min() < 20
    assert dark.min() >= 0
    assert full.max() == 1023
    assert dark.mean() == pytest.approx(20, abs=1)


def test_without_electrons_every_level_is_its_expected_number():
    response = Response(bits=12, black_level=240, gamma=2.2)
    levels = np.arange(256, dtype=np.uint8)[None]

    numbers = response.expose(levels, np.zeros((0, 0), np.int16))

    light = (np.arange(256) / 255) ** 2.2
    assert np.abs(numbers[0] - (240 + light * (4095 - 240))).max() <= 0.5 + 1 / 16


def test_another_key_shows_another_stretch_and_the_same_key_the_same():
    table = normal_table((1 << 20) + 100, 1)

    first, again, other = (stretch(table, (10, 10), (5, seq, 0)) for seq in (1, 1, 2))

    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert table.std() / 4096 == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"bits": 7}, "bits: expected 8 to 16, got 7"),
        ({"black_level": 255}, "black_level: expected 0 to 254, got 255"),
        ({"black_level": -1}, "black_level: expected 0 to 254, got -1"),
        ({"full_well_e": float("inf")}, "full_well_e: must be at least 0, got inf"),
        ({"read_noise_e": 3.0}, "read_noise_e: needs full_well_e"),
    ],
)
def test_what_no_sensor_has_is_refused(values, named):
    with pytest.raises(SettingsError, match=named):
        Response(**values)
