"""Light and weather: names and a seed -> lamps, tint, haze and noise of a whole match."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import PITCH_M

LIGHTS = ("sun", "floodlight")
WEATHERS = ("dry", "rain")
SUN_M = 1e6  # so far that its shadows are parallel


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """What throws one shadow of everybody."""

    place_m: tuple[float, float, float]  # on the pitch's axes; z up
    depth: float  # darkness of its shadows, 0..1
    soft_m: float  # width of their edges

    def shift(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the shadow of one metre of height falls, from its foot: (n, 2) metres."""
        x, y, z = self.place_m
        return np.asarray((points[:, :2] - (x, y)) / z)


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What light and weather make of everything."""

    lamps: tuple[Lamp, ...]
    tint: NDArray[np.float64]  # (3,) of grass, stands and people
    stand_light: float  # of the stands beside the pitch
    sky: NDArray[np.float64]  # (3,) its colour
    contact: float  # darkness of the ground right under an object
    haze: float  # share of the grey of the air in everything, 0..1
    haze_level: float  # that grey
    grain: float  # standard deviation of the sensor's noise, digital numbers
    drops: int  # of rain in the air, traces in about a megapixel
    gloss: float  # wet ground: contrast of its sheen


def draw_conditions(rng: np.random.Generator, light: str, weather: str) -> Conditions:
    """Draw the conditions of a match; the same number of draws for all of them."""
    warm = 1 + rng.normal(0, 0.025, 3)
    level, turn, low = rng.uniform(0.93, 1.06), rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 1.7)
    deep, noise, high = rng.uniform(0.45, 0.6), rng.uniform(0.8, 1.6), rng.uniform(30, 45)
    rain, lit = weather == "rain", light == "floodlight"
    if lit:
        lamps = _masts(float(high), 0.12 if rain else 0.2)
    else:
        away = low * SUN_M * np.array([np.cos(turn), np.sin(turn)])
        sun = Lamp(
            place_m=(float(away[0]), float(away[1]), SUN_M),
            depth=float(deep) * (0.45 if rain else 1.0),  # through thin clouds
            soft_m=0.25 if rain else 0.04,
        )
        lamps = (sun,)
    cool = np.array([0.93, 0.98, 1.03]) if lit else np.array([1.03, 1.0, 0.95])
    return Conditions(
        lamps=lamps,
        tint=np.asarray(warm * cool * level * (0.86 if rain else 1.0)),
        stand_light=float(level) * (0.45 if lit else 0.95) * (0.85 if rain else 1.0),
        sky=np.array([16, 18, 30] if lit else [150, 158, 166] if rain else [120, 160, 205], float),
        contact=0.28,
        haze=0.16 if rain else 0.0,
        haze_level=95.0 if lit else 150.0,
        grain=float(noise) * (1.6 if lit else 1.0),
        drops=260 if rain else 0,
        gloss=0.08 if rain else 0.0,
    )


def _masts(height_m: float, depth: float) -> tuple[Lamp, ...]:
    """Return the lamps of a stadium, one beyond each corner."""
    width, deep = PITCH_M
    return tuple(
        Lamp(place_m=(x, y, height_m), depth=depth, soft_m=0.12)
        for x in (-18.0, width + 18.0)
        for y in (-22.0, deep + 22.0)
    )
