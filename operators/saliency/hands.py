"""Draw hands around a ball, or around nothing: a picture -> a picture.

A goalkeeper who has the ball holds gloves before it, bright ones mostly, and no labelled still
shows many of them. Hands without a ball are drawn as well: a glove alone is none.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import FINE, blend
from operators.saliency.marks import Picture

SKIN_SHARE = 0.25  # of the hands: a throw-in, or a glove in the colour of skin
SLEEVE_SHARE = 0.6  # of the hands whose arm is seen, too
BOTH_SHARE = 0.6  # of the balls held with two hands
PLAIN_SHARE = 0.35  # of the gloves: black or white


def hands_over(
    picture: Picture, place: tuple[float, float], diameter_px: float, rng: np.random.Generator
) -> Picture:
    """Return the picture with one or two hands that hold what is at `place`.

    They cover a third of a ball of that diameter, seldom more than three quarters.
    """
    reach = int(np.ceil(diameter_px * 2.5)) + 2
    side = 2 * reach + 1
    left, top = int(place[0]) - reach, int(place[1]) - reach
    middle = np.array([place[0] - left, place[1] - top]) * FINE
    first = rng.uniform(0, 2 * np.pi)
    angles = [first]
    if rng.random() < BOTH_SHARE:  # the other hand: mostly on the other side
        angles.append(first + np.pi + rng.normal() * 0.7)
    colour = _colour(rng)
    drawn = picture.copy()
    for angle in angles:
        cover = np.zeros((side * FINE, side * FINE), np.float32)
        arm = np.zeros_like(cover)
        _hand(cover, arm, middle, angle, diameter_px * FINE, rng)
        if rng.random() < SLEEVE_SHARE:
            blend(drawn, left, top, arm, arm, rng.uniform(0, 255, 3))
        shade = colour * rng.uniform(0.75, 1.15)
        blend(drawn, left, top, cover, cover, shade)
    return drawn


def _colour(rng: np.random.Generator) -> NDArray[np.float64]:
    """Of a glove: one bright colour, white or black; or of skin."""
    if rng.random() < SKIN_SHARE:
        return rng.uniform([120, 70, 50], [235, 185, 160])
    if rng.random() < PLAIN_SHARE:
        return np.full(3, rng.uniform(20, 60) if rng.random() < 0.5 else rng.uniform(180, 250))
    hue = np.array([[rng.integers([0, 140, 170], [180, 256, 256])]], np.uint8)
    return np.asarray(cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0], np.float64)


def _hand(
    cover: NDArray[np.float32], arm: NDArray[np.float32], middle: NDArray[np.float64],
    angle: float, diameter: float, rng: np.random.Generator,
) -> None:  # fmt: skip
    """Draw palm and fingers into `cover`, the arm into `arm`; all in sub-pixels."""
    outward = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-outward[1], outward[0]])
    palm = middle + outward * diameter * rng.uniform(0.35, 0.7)
    sides = diameter * rng.uniform(0.45, 0.8), diameter * rng.uniform(0.25, 0.5)
    turn = np.degrees(angle) + 90 + rng.normal() * 15
    cv2.ellipse(cover, (_point(palm), sides, turn), 1.0, -1)
    thick = max(1, round(diameter * rng.uniform(0.1, 0.2)))
    for finger in np.linspace(-0.5, 0.5, int(rng.integers(2, 5))):
        root = palm + across * finger * sides[0]
        tip = root - outward * diameter * rng.uniform(0.15, 0.6)
        cv2.line(cover, _pixel(root), _pixel(tip), 1.0, thick, cv2.LINE_AA)
    bent = outward + across * rng.normal() * 0.8
    elbow = palm + bent / np.linalg.norm(bent) * diameter * 2
    cv2.line(arm, _pixel(palm), _pixel(elbow), 1.0, max(1, round(diameter * 0.35)), cv2.LINE_AA)


def _point(place: NDArray[np.float64]) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _pixel(place: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))
