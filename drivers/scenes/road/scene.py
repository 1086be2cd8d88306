"""A street as a car sees it: seed, frame number and window -> pixels; frame number -> truth."""

from collections import OrderedDict
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.limits import check_scene
from drivers.scenes.road import lettering, words
from drivers.scenes.road.conditions import WEATHERS, draw_conditions
from drivers.scenes.road.drawing import Seen, View, paint_ground, paste, seen
from drivers.scenes.road.panels import Lettered, Panel
from drivers.scenes.road.street import SEGMENT_M, Street
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

Image = NDArray[np.uint8]

ILLEGIBLE = "###"  # the label of a text that is not to be scored in this frame
LEAST_LEGIBLE_PX = 10.0  # height of a text's ink at full resolution
LEAST_LETTER_PX = 4.0  # width of a letter, which a slanting board narrows
MOST_BLUR = 0.35  # of its height, by which a text may move during the exposure
LEAST_SEEN = 0.85  # share of a text that must be visible
LEAST_TEXT_PX = 2.0  # height of the smallest text that is told at all
USUAL_PX = 1280  # width for which the street has its usual width
HALF_WIDTH_M = 10.0
FOCAL = 0.9  # of the picture's width
FARTHEST_M = 95.0
TILE = 512  # side of the noise and of the rain
MOST_SEGMENTS = 256  # kept
MOST_TILES = 4  # of noise, kept
HAZE_LEVEL = 190


@dataclass(frozen=True, kw_only=True, eq=False)
class Quad:
    """A text in the picture: its outline (4, 2), clockwise from the upper left of its reading."""

    text: Lettered
    corners: NDArray[np.float32]
    seen: float  # share that nothing hides
    blur_px: float  # by which it moves during the exposure

    @property
    def legible(self) -> bool:
        """Whether a reader could read it at full resolution."""
        a, b, c, d = self.corners
        tall = min(np.linalg.norm(a - d), np.linalg.norm(b - c))
        wide = min(np.linalg.norm(a - b), np.linalg.norm(d - c)) / max(1, len(self.text.text))
        clear = tall >= LEAST_LEGIBLE_PX and wide >= LEAST_LETTER_PX
        clear = clear and self.blur_px <= MOST_BLUR * tall
        return bool(clear and self.seen >= LEAST_SEEN and not self.text.foreign)


class RoadScene:
    """An endless drive through a street full of texts, with the exact truth of each.

    The camera looks ahead. Texts grow until they leave the picture at its sides: shop boards on the
    houses, signs across them, traffic signs, and plates of cars ahead. In a picture of 1280x720 the
    houses are 10 m away; a larger one shows a wider street, so that its texts are no larger in
    pixels, and more. The picture is read by windows or whole; the same seed gives the same street
    in any order of access. `fonts` is a folder with fonts in place of the installed ones.
    """

    shows = "street"

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = (1280, 720),
        rate_hz: float = 10.0,
        seed: int = 0,
        length: int | None = None,
        weather: str = "mixed",
        fonts: str = "",
    ) -> None:
        check_scene(size_px, rate_hz, seed, length)
        if weather not in WEATHERS:
            raise SettingsError(f"weather: expected {' or '.join(WEATHERS)}, got {weather!r}")
        self.size_px = (int(size_px[0]), int(size_px[1]))
        self.rate_hz, self.length = rate_hz, length
        self._seed, self._larger = seed, size_px[0] / USUAL_PX
        rng = np.random.default_rng([seed, 60])
        self._conditions = draw_conditions(rng, weather)
        self._waves = rng.uniform(0, 2 * np.pi, 6)
        self._street = Street(
            seed=seed, half_width_m=HALF_WIDTH_M * self._larger, conditions=self._conditions,
            fonts=lettering.fonts(fonts, words.ENGLISH), many_scripts=lettering.with_many_scripts(),
        )  # fmt: skip
        self._cars = self._street.cars()
        self._segments: OrderedDict[tuple[int, int], list[Panel]] = OrderedDict()
        self._tiles: dict[int, NDArray[np.int16]] = {}  # noise and rain by reduction
        self._last: tuple[int, View, list[Seen]] | None = None

    def picture(self, index: int) -> Image:
        """Draw frame `index` (h, w, 3) RGB; IndexError past the end."""
        width, height = self.size_px
        out = np.empty((height, width, 3), np.uint8)
        self.window(index, 0, 0, width, height, 1, out)
        return out

    def window(
        self, index: int, left: int, top: int, width: int, height: int, reduce: int, out: Image
    ) -> None:
        """Fill `out` with a window of frame `index`, averaged over `reduce` x `reduce` pixels."""
        _, view, panels = self._placed(index)
        wide, high = self.size_px
        inside = 0 <= left <= wide - width and 0 <= top <= high - height
        if not inside or min(width, height, reduce) < 1 or width % reduce or height % reduce:
            raise DriverError(
                f"road: expected a window inside {wide}x{high}, sides multiples of {reduce}, got "
                f"{width}x{height} at {left}, {top}"
            )
        kernel = self._kernel(index, reduce)
        rim = kernel // 2 * reduce
        shape = height // reduce + 2 * (kernel // 2), width // reduce, 4
        canvas = np.empty(shape, np.uint8)
        c = self._conditions
        paint_ground(
            canvas, view, left, top - rim, reduce, self._street.half_width_m, c.sky, c.light
        )
        for each in panels:
            paste(canvas, each, left, top - rim, reduce)
        if kernel > 1:
            canvas = cv2.blur(canvas, (1, kernel))[kernel // 2 : -(kernel // 2)]  # type: ignore[assignment]
        self._finish(canvas, index, left, top, reduce, out)

    def truth(self, index: int) -> Annotations:
        """Return box, text and visible share of the texts in frame `index`.

        The label is `###` where a text is in another script, too small, slanting or hidden.
        """
        quads = self.quads(index)
        most = np.array([*self.size_px, *self.size_px])
        boxes = [np.clip([*q.corners.min(0), *q.corners.max(0)], 0, most) for q in quads]
        return Annotations(
            boxes=np.array(boxes, np.float32).reshape(-1, 4),
            ids=np.array([q.text.id for q in quads], np.int32),
            labels=tuple(q.text.text if q.legible else ILLEGIBLE for q in quads),
            visibility=np.array([q.seen for q in quads], np.float32),
        )

    def quads(self, index: int) -> list[Quad]:
        """Return the texts in frame `index` whose outline is at least partly in the picture."""
        _, view, panels = self._placed(index)
        covers = _Covers(self.size_px)
        shaken = self._shaken(index)
        found: list[tuple[int, Lettered, NDArray[np.float64]]] = []
        for order, each in enumerate(panels):
            covers.draw(order, each)
            for text in each.panel.texts:
                corners = view.pixels(each.panel.corners(text.place))
                tall = np.linalg.norm(corners[0] - corners[3])
                if tall >= LEAST_TEXT_PX:
                    found.append((order, text, corners))
        made = [
            Quad(
                text=text,
                corners=corners.astype(np.float32),
                seen=covers.share(order, corners),
                blur_px=float(np.linalg.norm((*panels[order].way, shaken))),
            )
            for order, text, corners in found
        ]
        return sorted((q for q in made if q.seen > 0), key=lambda q: q.text.id)

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def _placed(self, index: int) -> tuple[int, View, list[Seen]]:
        """Return the view of a frame and what is in it; raises `IndexError` past the end."""
        if index < 0 or (self.length is not None and index >= self.length):
            frames = "endless" if self.length is None else f"{self.length} frames long"
            raise IndexError(f"frame {index}: the scene is {frames}, counted from 0")
        if self._last is None or self._last[0] != index:
            time_s = index / self.rate_hz
            far = FARTHEST_M * self._larger
            view = self._view(time_s)
            first = int(view.z_m // SEGMENT_M)
            panels = [
                panel
                for number in range(first, first + int(far / SEGMENT_M) + 1)
                for side in (0, 1)
                for panel in self._segment(number, side)
            ]
            ahead = view.z_m + 2.0 * self._larger * np.sin(time_s * 0.5 + self._waves[0])
            panels += [
                replace(car, origin=(car.origin[0], car.origin[1], car.origin[2] + ahead))
                for car in self._cars
            ]
            moved_m = self._conditions.speed_m_s * self._conditions.exposure_s
            self._last = index, view, seen(panels, view, far, moved_m)
        return self._last

    def _segment(self, number: int, side: int) -> list[Panel]:
        key = number, side
        if key not in self._segments:
            self._segments[key] = self._street.segment(number, side)
            if len(self._segments) > MOST_SEGMENTS:
                self._segments.popitem(last=False)
        self._segments.move_to_end(key)
        return self._segments[key]

    def _view(self, time_s: float) -> View:
        """Return the view: the car rolls along, and its nose turns and nods a little."""
        width, height = self.size_px
        a, b, c, d, *_ = self._waves
        turn = 0.012 * np.sin(0.7 * time_s + a) + 0.006 * np.sin(1.9 * time_s + b)
        nod = 0.004 * np.sin(5.1 * time_s + c) + 0.003 * np.sin(8.3 * time_s + d)
        return View(
            size_px=self.size_px,
            focal_px=FOCAL * width,
            z_m=self._conditions.speed_m_s * time_s,
            centre_px=(width * (0.5 + turn), height * 0.5 + width * (0.06 + nod)),
        )

    def _shaken(self, index: int) -> float:
        """Return by how many pixels the camera shook upwards during the exposure."""
        rng = np.random.default_rng([self._seed, 65, index])
        return float(abs(rng.normal(0, self._conditions.shake)) * self._larger)

    def _kernel(self, index: int, reduce: int) -> int:
        """Return the side of the blur by which the camera shook, odd."""
        return 2 * int(self._shaken(index) / reduce / 2) + 1

    def _finish(
        self, canvas: Image, index: int, left: int, top: int, reduce: int, out: Image
    ) -> None:
        """Add haze, rain and noise, and write RGB."""
        cv2.cvtColor(canvas, cv2.COLOR_RGBA2RGB, dst=out)
        if haze := self._conditions.haze:
            cv2.convertScaleAbs(out, out, 1 - haze, HAZE_LEVEL * haze)
        rng = np.random.default_rng([self._seed, 63, index])
        down, right = rng.integers(TILE, size=2).tolist()
        tile = self._added(reduce)
        y = -((top // reduce + down) % TILE)
        while y < out.shape[0]:
            x = -((left // reduce + right) % TILE)
            while x < out.shape[1]:
                part = out[max(0, y) : y + TILE, max(0, x) : x + TILE]
                grain = tile[max(0, -y) :, max(0, -x) :][: part.shape[0], : part.shape[1]]
                cv2.add(part, grain, dst=part, dtype=cv2.CV_8U)
                x += TILE
            y += TILE

    def _added(self, reduce: int) -> NDArray[np.int16]:
        """Return rain and noise of a picture reduced by `reduce`: a tile (TILE, TILE, 3)."""
        if reduce not in self._tiles:
            rng = np.random.default_rng([self._seed, 64])
            noise = rng.normal(0, self._conditions.grain / reduce, (TILE, TILE))
            if self._conditions.weather == "rain":
                noise += _drops(rng) / reduce
            if len(self._tiles) >= MOST_TILES:
                self._tiles.clear()
            self._tiles[reduce] = np.repeat(np.round(noise).astype(np.int16)[..., None], 3, 2)
        return self._tiles[reduce]


def _drops(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return streaks of rain as a tile (TILE, TILE) of brightness."""
    drawn = np.zeros((TILE, TILE), np.float32)
    for _ in range(260):
        x, y = rng.integers(TILE, size=2)
        long = int(rng.integers(8, 30))
        end = int(x) + long // 8, int(y) + long
        cv2.line(drawn, (int(x), int(y)), end, float(rng.uniform(15, 45)))
    return drawn


class _Covers:
    """Which panel is seen where, at a quarter of the usual picture's resolution."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self._scale = min(0.5, 960 / size_px[0])
        shape = (int(np.ceil(side * self._scale)) for side in reversed(size_px))
        self._map = np.zeros(tuple(shape), np.int16)

    def draw(self, order: int, each: Seen) -> None:
        """Cover what is behind a panel."""
        if each.panel.picture[..., 3].min() == 255 or each.panel.texts:
            self._fill(self._map, each.corners, order + 1)
            return
        scaled = each.corners * self._scale
        (x0, y0), (x1, y1) = np.floor(scaled.min(0)).astype(int), np.ceil(scaled.max(0)).astype(int)
        size = max(1, x1 - x0), max(1, y1 - y0)
        alpha = cv2.resize(each.panel.picture[..., 3], size, interpolation=cv2.INTER_AREA)
        ax, ay = max(0, -x0), max(0, -y0)
        part = self._map[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)]
        solid = alpha[ay : ay + part.shape[0], ax : ax + part.shape[1]] > 127
        part[: solid.shape[0], : solid.shape[1]][solid] = order + 1

    def share(self, order: int, corners: NDArray[np.float64]) -> float:
        """Return the share of an outline on a panel that is in the picture and not hidden."""
        scaled = corners * self._scale
        low, high = np.floor(scaled.min(0)).astype(int), np.ceil(scaled.max(0)).astype(int) + 1
        whole = np.zeros((max(1, high[1] - low[1]), max(1, high[0] - low[0])), np.int16)
        self._fill(whole, corners - low / self._scale, 1)
        y0, x0 = max(0, low[1]), max(0, low[0])
        part = self._map[y0 : max(y0, high[1]), x0 : max(x0, high[0])]
        inside = whole[y0 - low[1] :, x0 - low[0] :][: part.shape[0], : part.shape[1]]
        seen_ = (inside[: part.shape[0], : part.shape[1]] == 1) & (part == order + 1)
        return float(seen_.sum()) / max(1, int(whole.sum()))

    def _fill(self, on: NDArray[np.int16], corners: NDArray[np.float64], value: int) -> None:
        points = np.round(np.clip(corners * self._scale - 0.5, -16000, 16000) * 16).astype(np.int32)
        cv2.fillConvexPoly(on, points, value, cv2.LINE_8, 4)
