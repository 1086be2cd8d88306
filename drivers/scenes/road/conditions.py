"""Light and weather of a street: a seed -> brightness, sky, rain, noise, how the camera shakes."""

from dataclasses import dataclass

import numpy as np

WEATHERS = ("clear", "rain", "night", "mixed")
SHARES = {"clear": 0.5, "rain": 0.25, "night": 0.25}  # of mixed


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What holds for a whole clip."""

    weather: str
    light: float  # what comes off things that are not lit, 0..1
    sky: tuple[float, float, float]
    haze: float  # share of grey in the picture
    grain: float  # standard deviation of the noise, digital numbers
    shake: float  # pixels per 1280 of width during one exposure, standard deviation
    exposure_s: float
    speed_m_s: float

    @property
    def night(self) -> bool:
        """Whether lamps give the light."""
        return self.weather == "night"


def draw_conditions(rng: np.random.Generator, weather: str) -> Conditions:
    """Draw the conditions of a clip."""
    if weather == "mixed":
        weather = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    night, rain = weather == "night", weather == "rain"
    sky = (26, 30, 44) if night else (170, 176, 182) if rain else (160, 196, 230)
    return Conditions(
        weather=weather,
        light=float(rng.uniform(0.28, 0.42) if night else rng.uniform(0.72, 1.0)),
        sky=tuple(float(c * rng.uniform(0.9, 1.08)) for c in sky),  # type: ignore[arg-type]
        haze=float(rng.uniform(0.08, 0.22)) if rain else 0.0,
        grain=float(rng.uniform(4, 9) if night else rng.uniform(1, 4)),
        shake=float(rng.uniform(0.5, 2.0)),
        exposure_s=float(1 / rng.uniform(40, 80) if night else 1 / rng.uniform(70, 240)),
        speed_m_s=float(rng.uniform(8, 15)),
    )
