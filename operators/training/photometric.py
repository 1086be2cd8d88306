"""Change light, colour and sharpness of a training picture: picture -> picture of the same size."""

import cv2
import numpy as np
from numpy.typing import NDArray


def recolour(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Gain and offset of each channel and gamma as one table; hue and saturation sometimes."""
    levels = np.arange(256, dtype=np.float32) / 255
    gain = rng.uniform(0.75, 1.25) * (1 + rng.normal(size=3) * 0.06)
    table = levels[:, None] ** rng.uniform(0.75, 1.35) * gain + rng.uniform(-0.08, 0.08)
    table = np.clip(table * 255, 0, 255).astype(np.uint8)
    picture = np.asarray(cv2.LUT(picture, table[:, None, :]), np.uint8)
    if rng.random() < 0.4:
        hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
        hsv[..., 0] = (hsv[..., 0].astype(np.int16) + rng.integers(-9, 10)) % 180
        hsv[..., 1] = cv2.convertScaleAbs(hsv[..., 1], alpha=rng.uniform(0.5, 1.4))
        picture = np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)
    return picture


def degrade(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Blur or sharpen, add noise, compress; each only sometimes."""
    draw = rng.random()
    if draw < 0.3:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.3, 1.0)), np.uint8)
    elif draw < 0.5:
        soft, amount = cv2.GaussianBlur(picture, (0, 0), 1.0), rng.uniform(0.2, 1.0)
        picture = np.asarray(cv2.addWeighted(picture, 1 + amount, soft, -amount, 0), np.uint8)
    if rng.random() < 0.3:
        noise = np.empty(picture.shape[:2], np.int16)  # of brightness: colour noise is finer
        cv2.setRNGSeed(int(rng.integers(2**31 - 1)))
        cv2.randn(noise, np.zeros(1), np.full(1, rng.uniform(1, 9)))
        picture = np.asarray(cv2.add(picture, cv2.merge([noise] * 3), dtype=cv2.CV_8U), np.uint8)
    if rng.random() < 0.35:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 95))]
        picture = np.asarray(cv2.imdecode(cv2.imencode(".jpg", picture, quality)[1], 1), np.uint8)
    return picture
