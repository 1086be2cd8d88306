"""How a pixel counts light: a picture of 8 bit in, digital numbers with photon and read noise out.

The Poisson-Gaussian model (Foi et al., IEEE TIP 17(10), 2008; EMVA 1288, section 2): the variance
of a pixel is that of its photons, which equals their mean, and that of its electronics. Photons are
drawn from the normal distribution of that variance, which is theirs from about 20 electrons on.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SettingsError

NORMAL_UNIT = 4096  # what a standard deviation is in a table of normal noise
STRIP = 32  # rows handled at a time, so that they stay in the cache
OFFSETS = 1 << 20  # places in a noise table where a picture's noise may begin


@dataclass(frozen=True, kw_only=True)
class Response:
    """The response of a sensor; raises `SettingsError` for what no sensor has."""

    bits: int = 8
    black_level: int = 0  # digital numbers in the dark
    gamma: float = 1.0  # light is (picture / 255) ^ gamma; 2.2 or so for a photograph
    full_well_e: float = 0.0  # electrons at the largest number; 0: no noise
    read_noise_e: float = 0.0  # electrons, one standard deviation

    def __post_init__(self) -> None:
        if not 8 <= self.bits <= 16:
            raise SettingsError(f"bits: expected 8 to 16, got {self.bits}")
        if not 0 <= self.black_level < self.white:
            raise SettingsError(
                f"black_level: expected 0 to {self.white - 1}, got {self.black_level}"
            )
        if not 0.1 <= self.gamma <= 10:
            raise SettingsError(f"gamma: expected 0.1 to 10, got {self.gamma}")
        for name in ("full_well_e", "read_noise_e"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name}: must be at least 0, got {value}")
        if 0 < self.full_well_e < 1:
            raise SettingsError(f"full_well_e: expected 0 or at least 1, got {self.full_well_e}")
        if self.read_noise_e and not self.full_well_e:
            raise SettingsError("read_noise_e: needs full_well_e, which gives electrons a size")

    @property
    def white(self) -> int:
        """The largest digital number."""
        return (1 << self.bits) - 1

    @property
    def electrons_per_number(self) -> float:
        """The gain K of EMVA 1288 is its inverse; 0 without noise."""
        return self.full_well_e / (self.white - self.black_level)

    @property
    def plain(self) -> bool:
        """Whether a picture of 8 bit comes out as it went in."""
        return self == Response()

    def mean(self, levels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected digital numbers of pixels 0..255, before rounding."""
        return self.black_level + (levels / 255) ** self.gamma * (self.white - self.black_level)

    def deviation(self, levels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Their standard deviation, in digital numbers."""
        if not self.full_well_e:
            return np.zeros(levels.shape)
        electrons = (levels / 255) ** self.gamma * self.full_well_e
        return np.sqrt(electrons + self.read_noise_e**2) / self.electrons_per_number

    @cached_property
    def _tables(self) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """Mean and deviation of the 256 levels in fixed point, 16 bits being white.

        Means are moved to the range of int16, whose additions saturate at dark and white, and have
        the half that rounds when the point is removed.
        """
        levels, unit = np.arange(256.0), 1 << 16 - self.bits
        means = np.rint(self.mean(levels) * unit + (unit // 2)).clip(0, 65535) - 32768
        deviations = np.rint(self.deviation(levels) * unit).clip(0, 32767)
        return means.astype(np.int16), deviations.astype(np.int16)

    def expose(
        self,
        picture: NDArray[np.uint8],
        normal: NDArray[np.int16],
        out: NDArray[np.uint16] | None = None,
    ) -> NDArray[np.uint16]:
        """Digital numbers (h, w) of a picture (h, w), into `out` where given.

        `normal` (h, w) is a stretch of a `normal_table`; without electrons it is not looked at.

        >>> Response(bits=12, black_level=64).expose(np.array([[0, 255]], np.uint8), NO_NOISE)
        array([[  64, 4095]], dtype=uint16)
        """
        means, deviations = self._tables
        numbers = np.empty(picture.shape, np.uint16) if out is None else out
        spread = np.empty((STRIP, picture.shape[1]), np.int16)
        for top in range(0, len(picture), STRIP):
            rows, strip = numbers[top : top + STRIP], picture[top : top + STRIP]
            counted = rows.view(np.int16)
            cv2.LUT(strip, means, counted)
            if self.full_well_e:
                noise = spread[: len(strip)]
                cv2.LUT(strip, deviations, noise)
                cv2.multiply(noise, normal[top : top + STRIP], noise, 1 / NORMAL_UNIT)
                cv2.add(counted, noise, counted)
            np.add(rows, np.uint16(32768), out=rows)  # back from the range of int16
            np.right_shift(rows, 16 - self.bits, out=rows)
        return numbers


NO_NOISE = np.zeros((0, 0), np.int16)


def normal_table(size: int, seed: int) -> NDArray[np.int16]:
    """Standard normal noise (size,) in units of `NORMAL_UNIT`, for `Response.expose`.

    Each picture shows another stretch of it: drawing every picture anew costs ten times as much.
    """
    drawn = np.random.default_rng(seed).standard_normal(size, np.float32)
    return np.asarray(np.rint(np.clip(drawn * NORMAL_UNIT, -32767, 32767)), np.int16)


def stretch(
    table: NDArray[np.int16], shape: tuple[int, ...], key: tuple[int, ...]
) -> NDArray[np.int16]:
    """Another stretch of the table for each key, e.g. (seed, seq, port).

    The table holds `OFFSETS` more numbers than the largest picture has.
    """
    start = int(np.random.default_rng(key).integers(OFFSETS))
    return table[start : start + math.prod(shape)].reshape(shape)
