"""Draw panels as a camera sees them: panels and a view -> pixels of a window, and outlines."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.road.panels import Panel
from drivers.scenes.soccer.blend import over

Image = NDArray[np.uint8]

NEAR_M = 0.6  # nearer than this nothing is drawn
EYE_M = 1.5  # height of the camera
LANE_M = 3.4
MOST_STREAK_PX = 63
DASH_M = (3.0, 9.0)  # length of a dash, and from one to the next


@dataclass(frozen=True, kw_only=True)
class View:
    """A camera that looks along the road."""

    size_px: tuple[int, int]
    focal_px: float
    z_m: float
    centre_px: tuple[float, float]  # where the road vanishes

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points (n, 3) that are all in front of it: (n, 2)."""
        away = points[:, 2] - self.z_m
        x = self.centre_px[0] + self.focal_px * points[:, 0] / away
        y = self.centre_px[1] - self.focal_px * (points[:, 1] - EYE_M) / away
        return np.column_stack([x, y])


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """A panel with its corners (4, 2) in the picture."""

    panel: Panel
    corners: NDArray[np.float64]
    away_m: float  # of its middle
    way: tuple[float, float] = (0.0, 0.0)  # pixels by which it moves during the exposure

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Where it is, xyxy."""
        (x0, y0), (x1, y1) = self.corners.min(0).tolist(), self.corners.max(0).tolist()
        return x0, y0, x1, y1


def seen(panels: list[Panel], view: View, farthest_m: float, moved_m: float) -> list[Seen]:
    """Return the panels in the picture in the order of drawing: walls, then the farthest first.

    The camera moves on by `moved_m` during the exposure, and blurs what it passes.
    """
    opened = replace(view, z_m=view.z_m - moved_m)
    found = []
    for panel in panels:
        corners = panel.corners()
        away = corners[:, 2] - view.z_m
        if away.min() < NEAR_M or away.max() > farthest_m:
            continue
        there = view.pixels(corners)
        way = (0.0, 0.0)
        if panel.texts and not panel.drives:
            dx, dy = (there - opened.pixels(corners)).mean(0).tolist()
            way = dx, dy
        each = Seen(panel=panel, corners=there, away_m=float(away.mean()), way=way)
        x0, y0, x1, y1 = each.box
        if x1 > 0 and y1 > 0 and x0 < view.size_px[0] and y0 < view.size_px[1]:
            found.append(each)
    return sorted(found, key=lambda each: (not each.panel.wall, -each.away_m))


def paste(out: Image, each: Seen, left: int, top: int, reduce: int) -> None:
    """Draw a panel over `out` (h, w, 4), a window that begins at `left`, `top`, reduced."""
    corners = (each.corners - (left, top)) / reduce
    high, wide = out.shape[:2]
    kernel = streak((each.way[0] / reduce, each.way[1] / reduce))
    rim = max(kernel.shape) // 2
    x0, y0 = np.maximum(np.floor(corners.min(0)).astype(int) - 1 - rim, 0)
    x1, y1 = np.minimum(np.ceil(corners.max(0)).astype(int) + 2 + rim, (wide, high))
    if x0 >= x1 or y0 >= y1:
        return
    lengths = np.linalg.norm(corners - np.roll(corners, -1, 0), axis=1)
    whole = each.panel.picture.shape
    factor = min(
        whole[1] / max(lengths[0], lengths[2], 0.1), whole[0] / max(lengths[1], lengths[3], 0.1)
    )
    picture = each.panel.reduced(factor)
    h, w = picture.shape[:2]
    source = np.array([(-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5)])
    there = (corners - (x0, y0) - 0.5).astype(np.float32)
    matrix = cv2.getPerspectiveTransform(source.astype(np.float32), there)
    if each.panel.wall:  # large and opaque: its edges may be hard
        cv2.warpPerspective(
            picture, matrix, (int(x1 - x0), int(y1 - y0)), dst=out[y0:y1, x0:x1],
            borderMode=cv2.BORDER_TRANSPARENT,
        )  # fmt: skip
        return
    patch = cv2.warpPerspective(picture, matrix, (int(x1 - x0), int(y1 - y0)))
    if rim:
        patch = cv2.filter2D(patch, -1, kernel, borderType=cv2.BORDER_CONSTANT)
    over(out, np.asarray(patch, np.uint8), int(x0), int(y0))


def streak(way: tuple[float, float]) -> NDArray[np.float32]:
    """Return the kernel of a movement by `way` pixels: a line of sum 1; 1x1 for less than a pixel.

    >>> streak((0.4, 0.2)).shape, streak((4.0, 0.0)).shape, float(streak((3.0, 3.0)).sum())
    ((1, 1), (5, 5), 1.0)
    """
    side = 2 * int(min(max(abs(way[0]), abs(way[1])), MOST_STREAK_PX) / 2) + 1
    kernel = np.zeros((side, side), np.float32)
    half, middle = side / 2 - 0.5, side // 2
    length = max(abs(way[0]), abs(way[1]), 1e-6)
    dx, dy = (round(half * part / length) for part in way)
    cv2.line(kernel, (middle - dx, middle - dy), (middle + dx, middle + dy), 1.0)
    return np.asarray(kernel / kernel.sum(), np.float32)


def paint_ground(
    out: Image, view: View, left: int, top: int, reduce: int, half_width_m: float,
    sky: tuple[float, float, float], light: float,
) -> None:  # fmt: skip
    """Fill `out` (h, w, 4) with sky, pavement and road."""
    _fill(out, sky)
    horizon = (view.centre_px[1] - top) / reduce
    first = int(np.clip(np.ceil(horizon), 0, out.shape[0]))
    _fill(out[first:], (128 * light, 124 * light, 120 * light))
    far, near = view.z_m + 2000.0, view.z_m + NEAR_M
    asphalt, white = np.array([72, 72, 76]) * light, np.array([214, 214, 208]) * light
    kerb = half_width_m - min(3.5, half_width_m * 0.4)
    _strip(out, view, (left, top, reduce), (-kerb, kerb), (near, far), asphalt)
    lanes = max(1, int(kerb / LANE_M))
    for lane in range(-lanes, lanes + 1):
        x = (lane - 0.5) * LANE_M
        if abs(x) > kerb:
            continue
        dash, step = DASH_M
        begin = np.floor(view.z_m / step) * step
        for z in np.arange(begin, begin + 14 * step, step):
            ends = max(z, near), max(z + dash, near + 0.01)
            _strip(out, view, (left, top, reduce), (x - 0.08, x + 0.08), ends, white)


def _fill(out: Image, colour: tuple[float, float, float]) -> None:
    """Set all of (h, w, 4) to a colour, four bytes at a time."""
    out.view(np.uint32)[:] = np.array([*colour, 255]).astype(np.uint8).view(np.uint32)


def _strip(
    out: Image, view: View, window: tuple[int, int, int], across: tuple[float, float],
    along: tuple[float, float], colour: NDArray[np.float64],
) -> None:  # fmt: skip
    left, top, reduce = window
    (x0, x1), (z0, z1) = across, along
    ends = np.array([(x0, 0, z0), (x1, 0, z0), (x1, 0, z1), (x0, 0, z1)])
    there = (view.pixels(ends) - (left, top)) / reduce - 0.5
    there = np.clip(there, -8000, 8000 + max(out.shape))
    points = np.round(there * 16).astype(np.int32)
    cv2.fillConvexPoly(out, points, (*colour.tolist(), 255), cv2.LINE_AA, 4)
