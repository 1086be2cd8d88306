"""Show a training picture as a raw sensor would: picture -> picture of the same size, with noise.

The light of the picture is counted in electrons, in few or in many, and developed again. A sensor
whose context is a mosaic loses colour resolution as well; one whose mosaic is averaged sums the
electrons of several samples.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.mosaic import to_mosaic
from drivers.noise import NORMAL_UNIT, Response
from pipeline.pixel_formats import ORDERS

BITS, BLACK, GAMMA = 12, 240, 2.2
FULL_WELL_E = (300.0, 20_000.0)  # electrons at white: a dark evening to a bright day
READ_NOISE_E = (2.0, 6.0)
SAMPLES = (4, 8, 4)  # of red, green and blue in a cell of 4x4 pixels


def through_sensor(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """An RGB picture (h, w, 3) as a sensor of random light and read-out shows it."""
    full_well_e = float(np.exp(rng.uniform(*np.log(FULL_WELL_E))))
    read_noise_e = float(rng.uniform(*READ_NOISE_E))
    if rng.random() < 0.5:
        order = list(ORDERS)[int(rng.integers(len(ORDERS)))]
        mosaic = np.empty(picture.shape[:2], np.uint8)
        to_mosaic(picture, order, mosaic)
        seen = _seen(mosaic, full_well_e, read_noise_e, 1, rng)
        how = getattr(cv2, f"COLOR_Bayer{order.upper()}2RGB")
        return np.asarray(cv2.cvtColor(seen, how), np.uint8)
    planes = [
        _seen(np.ascontiguousarray(picture[..., k]), full_well_e, read_noise_e, count, rng)
        for k, count in enumerate(SAMPLES)
    ]
    return np.asarray(cv2.merge(planes), np.uint8)


def _seen(
    plane: NDArray[np.uint8], full_well_e: float, read_noise_e: float, samples: int,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:  # fmt: skip
    """One plane (h, w), each of whose pixels is the mean of so many samples."""
    response = Response(
        bits=BITS, black_level=BLACK, gamma=GAMMA,
        full_well_e=full_well_e * samples, read_noise_e=read_noise_e * samples**0.5,
    )  # fmt: skip
    drawn = rng.standard_normal(plane.shape, np.float32) * NORMAL_UNIT
    numbers = response.expose(plane, np.rint(drawn.clip(-32767, 32767)).astype(np.int16))
    light = (np.arange(response.white + 1.0) - BLACK).clip(0) / (response.white - BLACK)
    developed = np.rint(255 * light ** (1 / GAMMA)).astype(np.uint8)
    return developed[numbers]
