"""Shadows on the ground: an actor and the lamps -> how much light each pixel beside it loses."""

from collections.abc import Sequence
from math import ceil, floor

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import View
from drivers.scenes.soccer.shadows import contact
from drivers.scenes.soccer.stage import Actor
from drivers.scenes.whole_pitch.conditions import Lamp
from drivers.scenes.whole_pitch.layers import Layer

Image = NDArray[np.uint8]
Way = tuple[float, float]  # pixels to the right and down, per pixel of height

COARSE_PX_PER_M = 26.0  # a shadow is drawn at about this scale, and enlarged
FLATTEST = 0.02  # least fall of a shadow per height, as a flat one has no area
DARKEST = 215
THICK_M = 0.14  # of a body, as a shadow shows it down the picture


def shadows(
    actors: Sequence[Actor], view: View, lamps: Sequence[Lamp], contact_depth: float
) -> list[Layer]:
    """Return a layer for each actor: the shadows that all lamps throw, and the one right under it.

    The places of the lamps are in the camera's frame. A pixel of the actor is as high above the
    ground as it is above the point of the ground under it.
    """
    if not actors:
        return []
    ways = _ways(actors, view, lamps)
    return [_shadow(a, ways[n], lamps, contact_depth) for n, a in enumerate(actors)]


def _ways(actors: Sequence[Actor], view: View, lamps: Sequence[Lamp]) -> list[list[Way]]:
    """Return, by actor and lamp, where a pixel's shadow falls per pixel of its height."""
    at, scales = np.array([a.ground for a in actors]), np.array([a.scale for a in actors])
    ground = view.station.ground((at - np.array(view.size_px) / 2) / view.radius_px + view.aim)
    feet = np.column_stack([ground, np.zeros(len(ground))])
    found = []
    for lamp in lamps:
        shifted = feet + np.column_stack([lamp.shift(feet), np.zeros(len(feet))])
        found.append((view.pixels(shifted) - at) / scales[:, None])
    ways = np.stack(found, 1)  # (n, lamps, 2)
    down = ways[..., 1]
    down[np.abs(down) < FLATTEST] = FLATTEST
    return [[(x, y) for x, y in row] for row in ways.tolist()]


def _shadow(
    actor: Actor, ways: Sequence[Way], lamps: Sequence[Lamp], contact_depth: float
) -> Layer:
    """Return all shadows of one actor; they are drawn `coarse` pixels to one."""
    coarse = max(1, round(actor.scale / COARSE_PX_PER_M))
    foot = actor.ground[0] - actor.left, actor.ground[1] - actor.top
    small = (0.13, 0.05) if actor.label == "ball" else (0.42, 0.12)
    spot = contact(*(max(1, round(m * actor.scale / coarse)) for m in small), contact_depth)
    spot = np.ascontiguousarray(spot[..., 3])
    edge = max(THICK_M, *(lamp.soft_m for lamp in lamps)) * actor.scale + 2 * coarse
    left, top, right, bottom = _bounds(actor.patch.shape[:2], foot, ways, edge)
    half_w, half_h = (coarse * (side // 2 + 1) for side in spot.shape[::-1])
    left, top = min(left, floor(foot[0] - half_w)), min(top, floor(foot[1] - half_h))
    right, bottom = max(right, ceil(foot[0] + half_w)), max(bottom, ceil(foot[1] + half_h))
    size = -(-(right - left) // coarse), -(-(bottom - top) // coarse)
    dark = np.zeros(size[::-1], np.uint8)
    flat = _flat(actor.patch, coarse)
    for lamp, way in zip(lamps, ways, strict=True):
        m = _matrix(actor.patch.shape[:2], flat.shape[:2], foot, way, (left, top), coarse)
        cv2.add(dark, _thrown(flat, m, size, lamp, actor.scale / coarse), dst=dark)
    x = round((foot[0] - left) / coarse) - spot.shape[1] // 2
    y = round((foot[1] - top) / coarse) - spot.shape[0] // 2
    place = dark[y : y + spot.shape[0], x : x + spot.shape[1]]
    cv2.add(place, spot[: place.shape[0], : place.shape[1]], dst=place)
    cv2.min(dark, np.full_like(dark, DARKEST), dst=dark)
    if coarse > 1:
        dark = np.asarray(cv2.resize(dark, (size[0] * coarse, size[1] * coarse)), np.uint8)
    return Layer(patch=dark, left=actor.left + left, top=actor.top + top)


def _thrown(
    flat: Image, m: NDArray[np.float64], size: tuple[int, int], lamp: Lamp, px_per_m: float
) -> Image:
    """Return how much light of one lamp is lost, softened at the edges: (h, w) of `size`."""
    dark = cv2.warpAffine(flat, m, size, flags=cv2.INTER_LINEAR)
    soft_m = lamp.soft_m, max(lamp.soft_m, THICK_M)
    wide, high = (round(metres * px_per_m) | 1 for metres in soft_m)
    if max(wide, high) > 1:
        dark = cv2.blur(dark, (wide, high))
    return np.asarray(cv2.convertScaleAbs(dark, alpha=lamp.depth), np.uint8)


def _flat(patch: Image, coarse: int) -> Image:
    """Return what throws the shadow, at the scale at which shadows are drawn."""
    alpha = cv2.extractChannel(patch, 3)
    if coarse == 1:
        return np.asarray(alpha, np.uint8)
    size = max(1, patch.shape[1] // coarse), max(1, patch.shape[0] // coarse)
    return np.asarray(cv2.resize(alpha, size, interpolation=cv2.INTER_AREA), np.uint8)


def _bounds(
    shape: tuple[int, ...],
    foot: tuple[float, float],
    ways: Sequence[Way],
    edge: float,
) -> tuple[int, int, int, int]:
    """Return the box of all shadows in pixels of the actor's patch."""
    xs, ys = [foot[0]], [foot[1]]
    for aside, down in ways:
        for height in (foot[1], foot[1] - shape[0]):
            xs += [aside * height, shape[1] + aside * height]
            ys.append(foot[1] + down * height)
    return floor(min(xs) - edge), floor(min(ys) - edge), ceil(max(xs) + edge), ceil(max(ys) + edge)


def _matrix(
    shape: tuple[int, ...],
    small: tuple[int, ...],
    foot: tuple[float, float],
    way: Way,
    corner: tuple[int, int],
    coarse: int,
) -> NDArray[np.float64]:
    """Return the map (2, 3) from the flattened actor to the coarse shadow, by pixel centres."""
    row, column = shape[0] / small[0], shape[1] / small[1]  # of the patch in one of the flattened
    aside, down = way
    high = foot[1] - row / 2  # of the flattened actor's first row
    return np.array(
        [
            [
                column / coarse,
                -aside * row / coarse,
                (column / 2 + aside * high - corner[0]) / coarse - 0.5,
            ],
            [0.0, -down * row / coarse, (foot[1] + down * high - corner[1]) / coarse - 0.5],
        ]
    )
