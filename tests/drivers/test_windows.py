"""Sources that are read by windows: what sensors make of them equals what whole pictures give."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.sensor import Exposure
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from drivers.simulated.windows import LEAST_REST, picture_of, reads_windows, whole_reduction
from drivers.source import Annotations
from tests.drivers.contract import read, started
from tests.drivers.moving_square import MovingSquare
from tests.drivers.usb.boards import board

SIZE = (320, 192)
SOURCES = (f"{__name__}:Windowed", f"{__name__}:Whole")


class Whole:
    """Noise."""

    def __init__(self, *, size_px: tuple[int, int] = SIZE, **_: Any) -> None:
        self.size_px, self.rate_hz = size_px, 30.0
        self.length: int | None = 20

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return frame `index`, whole."""
        width, height = self.size_px
        return np.random.default_rng(index).integers(0, 256, (height, width, 3), np.uint8)

    def truth(self, index: int) -> Annotations | None:
        """Return None: it is noise."""
        return None

    def close(self) -> None:
        """Hold nothing."""


class Windowed(Whole):
    """The same noise, made only where it is looked at."""

    def window(
        self, index: int, left: int, top: int, width: int, height: int, reduce: int,
        out: NDArray[np.uint8],
    ) -> None:  # fmt: skip
        """Fill `out` with means."""
        crop = self.picture(index)[top : top + height, left : left + width]
        cells = crop.reshape(height // reduce, reduce, width // reduce, reduce, 3)
        out[...] = np.rint(cells.mean((1, 3)))


def sensor(**options: Any) -> SimulatedSensor:
    """Return a started sensor over the noise."""
    subject = SimulatedSensor(SimulatedSensorSettings(**options))
    subject.open(realtime=False)
    subject.start()
    return subject


def exposures(subject: SimulatedSensor, count: int) -> list[Exposure]:
    found = [read(subject) for _ in range(count)]
    subject.close()
    return found


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"roi_scale": 0.5, "budget": 1.0},
        {"mosaic": True, "pixel_format": "bayer_rggb12p"},
        {"strategy": "round_robin"},
        {"strategy": "exposure", "budget": 0.5},  # averaged pictures are made whole
    ],
)
def test_a_simulated_sensor_reads_the_same_by_windows(options: dict[str, Any]) -> None:
    by_windows, by_wholes = (exposures(sensor(source=name, **options), 3) for name in SOURCES)

    for one, other in zip(by_windows, by_wholes, strict=True):
        assert one.roi.window == other.roi.window
        for a, b in ((one.context, other.context), (one.roi, other.roi)):
            assert a.pixels.shape == b.pixels.shape
            if a.pixel_format.endswith("12p"):
                assert (a.pixels == b.pixels).mean() > 0.5
            elif a.pixels.size:
                assert np.abs(a.pixels.astype(int) - b.pixels).max() <= 1


def test_a_ratio_that_is_not_whole_is_reduced_in_two_steps() -> None:
    one, other = (exposures(sensor(source=n, context_scale=1 / 3, budget=1.0), 1) for n in SOURCES)

    a, b = one[0].context.pixels, other[0].context.pixels
    assert a.shape == b.shape == (64, 107, 3)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.8


def test_a_virtual_board_reads_the_same_by_windows() -> None:
    seen = []
    for name in SOURCES:
        subject = started(board(virtual={"scene": name}))
        seen.append([read(subject) for _ in range(3)])
        subject.close()

    for one, other in zip(*seen, strict=True):
        assert np.array_equal(one.roi.pixels, other.roi.pixels)
        assert np.abs(one.context.pixels.astype(int) - other.context.pixels).max() <= 1


def test_a_source_without_windows_gives_its_pictures() -> None:
    plain = MovingSquare()

    assert not reads_windows(plain)
    assert isinstance(picture_of(plain, 0), np.ndarray)


@given(st.tuples(st.integers(1, 4000), st.integers(1, 4000)), st.data())
def test_a_reduction_divides_both_sides_and_leaves_enough_pixels(
    size_px: tuple[int, int], data: st.DataObject
) -> None:
    to_px = tuple(data.draw(st.integers(1, side)) for side in size_px)

    reduce = whole_reduction(size_px, (to_px[0], to_px[1]))

    assert size_px[0] % reduce == size_px[1] % reduce == 0
    assert size_px[0] // reduce >= to_px[0]
    assert size_px[1] // reduce >= to_px[1]
    rests = [side / reduce / to for side, to in zip(size_px, to_px, strict=True)]
    # averaging a second time by a little would blur
    assert reduce == 1 or all(rest.is_integer() or rest >= LEAST_REST for rest in rests)


def test_a_second_step_keeps_the_contrast_of_exact_means() -> None:
    size = {"size_px": (320, 180)}
    one, other = (
        exposures(sensor(source=n, source_options=size, context_scale=0.44, budget=1.0), 1)
        for n in SOURCES
    )

    a, b = one[0].context.pixels, other[0].context.pixels
    assert a.astype(float).std() > 0.95 * b.astype(float).std()
