"""What stands along a street: seed, side and segment -> panels with their texts.

A street is a row of segments of `SEGMENT_M` on each side, drawn each from its own seed, so that any
of them can be made alone. A wider street (`width_m`) has its houses farther away.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.road import lettering, words
from drivers.scenes.road.conditions import Conditions
from drivers.scenes.road.panels import Colour, Lettered, Panel, board, opaque

Image = NDArray[np.uint8]
Line = tuple[int, str, bool]  # id, text, foreign

SEGMENT_M = 12.0
WALL_PX_PER_M = 32
SLOTS = 16  # ids of a segment
CARS = 8
WIDENED = 1.7  # letters along the street, as painters do where people come along it
FOREIGN_SHARE = 0.15
WALLS: tuple[Colour, ...] = (
    *((150, 90, 70), (176, 160, 140), (120, 112, 104), (196, 186, 170), (140, 120, 96)),
    *((98, 88, 84), (180, 140, 110), (208, 204, 196)),
)
BOARDS: tuple[tuple[Colour, Colour], ...] = (  # ground and ink
    *(((24, 44, 90), (245, 240, 225)), ((140, 24, 30), (250, 240, 220))),
    *(((20, 70, 44), (240, 235, 200)), ((30, 30, 34), (235, 205, 120))),
    *(((236, 232, 220), (40, 36, 34)), ((244, 214, 70), (30, 30, 30))),
    *(((90, 40, 96), (250, 245, 250)), ((214, 226, 232), (140, 20, 34))),
    *(((250, 250, 250), (20, 80, 160)), ((200, 90, 30), (255, 250, 240))),
)
SIGNS: tuple[tuple[Colour, Colour], ...] = (
    *(((0, 70, 150), (250, 250, 250)), ((0, 100, 60), (250, 250, 250))),
    *(((250, 250, 250), (20, 20, 20)), ((250, 210, 40), (20, 20, 20))),
)
PAINTS: tuple[Colour, ...] = (
    *((180, 30, 34), (40, 60, 110), (230, 230, 228), (36, 38, 42), (140, 144, 148)),
    *((70, 100, 80), (200, 170, 60)),
)


@dataclass(frozen=True, kw_only=True)
class Street:
    """Makes segments and cars of one street."""

    seed: int
    half_width_m: float  # from the camera's path to the houses
    conditions: Conditions
    fonts: tuple[Path, ...]
    many_scripts: Path | None

    def segment(self, index: int, side: int) -> list[Panel]:
        """Return the panels of a segment on the left (side 0) or right (1)."""
        rng = np.random.default_rng([self.seed, 61, index, side])
        slots = iter(range(1, SLOTS))
        sign = -1 if side == 0 else 1
        start, x = index * SEGMENT_M, sign * self.half_width_m
        first = (index * 2 + side) * SLOTS
        tall = float(rng.uniform(7, 13))
        deep = SEGMENT_M * (0.85 if rng.random() < 0.15 else 1.0)  # a gap to the next house
        found = [self._wall(rng, x, start, deep, tall)]
        found += self._shop(rng, x, start, deep, lambda: first + next(slots))
        if rng.random() < 0.45:
            found.append(self._blade(rng, x, start, sign, lambda: first + next(slots)))
        if rng.random() < 0.4:
            found += self._pole_sign(rng, x, start, sign, lambda: first + next(slots))
        elif rng.random() < 0.3:
            found += self._tree(rng, x, start, sign)
        return found

    def cars(self) -> list[Panel]:
        """Return the backs of cars that drive ahead; their place is that at the start."""
        found = []
        k = self.half_width_m / 10.0
        for number in range(CARS):
            rng = np.random.default_rng([self.seed, 62, number])
            lane = float(rng.choice([0.0, 3.2, -3.4])) * (1 if number < 3 else k * 0.6)
            ahead = (7 + 7 * number) * k * float(rng.uniform(0.9, 1.1))
            id_ = -(number + 1)
            found += self._car(rng, lane, ahead, id_)
        return found

    def _line(self, rng: np.random.Generator, id_: int, text: str) -> tuple[Line, Path]:
        """Return a text as it stands on a board, at times in another script, and its font."""
        if self.many_scripts is not None and rng.random() < FOREIGN_SHARE:
            return (id_, words.foreign(rng), True), self.many_scripts
        font = self.fonts[int(rng.integers(len(self.fonts)))]
        lettering.check_glyphs(font, text)
        return (id_, text, False), font

    def _wall(
        self, rng: np.random.Generator, x: float, z: float, deep: float, tall: float
    ) -> Panel:
        colour = np.array(WALLS[int(rng.integers(len(WALLS)))]) * rng.uniform(0.85, 1.1)
        size = round(tall * WALL_PX_PER_M), round(deep * WALL_PX_PER_M)
        drawn = np.clip(colour + rng.normal(0, 7, (*size, 1)), 0, 255).astype(np.float32)
        glass = (60, 72, 84) if not self.conditions.night else (214, 180, 110)
        step = float(rng.uniform(2.0, 3.2))
        for up in np.arange(4.6, tall - 1.2, 2.8):
            for along in np.arange(0.8, deep - 1.2, step):
                lit = not self.conditions.night or rng.random() < 0.4
                box = [(along, tall - up - 1.5), (along + 1.1, tall - up)]
                (x0, y0), (x1, y1) = (np.array(p) * WALL_PX_PER_M for p in box)
                shade = glass if lit else (30, 32, 38)
                cv2.rectangle(drawn, (int(x0), int(y0)), (int(x1), int(y1)), shade, -1)
        front = round((tall - 3.0) * WALL_PX_PER_M)
        window = np.array((70, 84, 92)) * rng.uniform(0.7, 1.2)
        cv2.rectangle(drawn, (10, front), (size[1] - 10, size[0] - 14), window.tolist(), -1)
        for along in np.arange(2, deep, 2.4):
            at = round(along * WALL_PX_PER_M)
            cv2.line(drawn, (at, front), (at, size[0]), (colour * 0.6).tolist(), 4)
        return self._facing(
            x, z, deep, tall, tall, opaque(drawn * self.conditions.light), wall=True
        )

    def _facing(
        self, x: float, z: float, deep: float, tall: float, top: float, picture: Image,
        texts: tuple[Lettered, ...] = (), *, wall: bool = False,
    ) -> Panel:  # fmt: skip
        """Return a panel on a house's front: read from left to right by who looks at it."""
        begin, way = (z, deep) if x < 0 else (z + deep, -deep)
        return Panel(
            origin=(x, top, begin), along=(0, 0, way), down=(0, -tall, 0), picture=picture,
            texts=texts, wall=wall,
        )  # fmt: skip

    def _shop(
        self, rng: np.random.Generator, x: float, z: float, deep: float, next_id: Callable[[], int]
    ) -> list[Panel]:
        """Return one or two name boards above the shop's window."""
        found = []
        count = 1 if rng.random() < 0.6 else 2
        room = deep / count
        for number in range(count):
            line, font = self._line(rng, next_id(), words.shop(rng))
            ground, ink = BOARDS[int(rng.integers(len(BOARDS)))]
            picture, (wide, high), texts = board(
                [line], font, letter_m=float(rng.uniform(0.26, 0.5)), ink=ink, ground=ground,
                light=self._light(rng),
            )  # fmt: skip
            wide *= WIDENED
            fit = min(1.0, 0.94 * room / wide, 1.1 / high)
            wide, high = wide * fit, high * fit
            begin = z + number * room + (room - wide) / 2
            nearer = x * (1 - 0.02 / abs(x))
            found.append(self._facing(nearer, begin, wide, high, 3.1 + high, picture, texts))
        return found

    def _blade(
        self, rng: np.random.Generator, x: float, z: float, sign: int, next_id: Callable[[], int]
    ) -> Panel:
        """Return a sign that stands out from the house, facing the camera."""
        line, font = self._line(rng, next_id(), words.shop(rng))
        ground, ink = BOARDS[int(rng.integers(len(BOARDS)))]
        picture, (wide, high), texts = board(
            [line], font, letter_m=float(rng.uniform(0.16, 0.28)), ink=ink, ground=ground,
            light=self._light(rng), rim=bool(rng.random() < 0.5),
        )  # fmt: skip
        fit = min(1.0, 2.2 / wide)
        wide, high = wide * fit, high * fit
        left = x - sign * (wide + 0.1) if sign > 0 else x + 0.1
        top, at = float(rng.uniform(3.6, 5.4)), z + float(rng.uniform(1, 11))
        return Panel(
            origin=(left, top, at), along=(wide, 0, 0), down=(0, -high, 0), picture=picture,
            texts=texts,
        )  # fmt: skip

    def _pole_sign(
        self, rng: np.random.Generator, x: float, z: float, sign: int, next_id: Callable[[], int]
    ) -> list[Panel]:
        """Return a traffic sign of one to three lines on its pole, at the kerb."""
        font = self.fonts[int(rng.integers(len(self.fonts)))]
        lines = []
        for _ in range(int(rng.integers(1, 4))):
            text = words.sign(rng)
            lettering.check_glyphs(font, text)
            lines.append((next_id(), text, False))
        ground, ink = SIGNS[int(rng.integers(len(SIGNS)))]
        picture, (wide, high), texts = board(
            lines, font, letter_m=float(rng.uniform(0.13, 0.24)), ink=ink, ground=ground,
            light=self._light(rng), rim=True,
        )  # fmt: skip
        at, kerb = z + float(rng.uniform(0, 12)), x - sign * float(rng.uniform(1.6, 3.2))
        low = float(rng.uniform(2.0, 2.6))
        grey = np.full((8, 8, 3), 110 * self.conditions.light, np.float32)
        pole = Panel(
            origin=(kerb - 0.05, low, at + 0.05), along=(0.1, 0, 0), down=(0, -low, 0),
            picture=opaque(grey),
        )  # fmt: skip
        plane = Panel(
            origin=(kerb - wide / 2, low + high, at), along=(wide, 0, 0), down=(0, -high, 0),
            picture=picture, texts=texts,
        )  # fmt: skip
        return [pole, plane]

    def _tree(self, rng: np.random.Generator, x: float, z: float, sign: int) -> list[Panel]:
        """Return a tree that hides what is behind it."""
        drawn = np.zeros((192, 128, 4), np.uint8)
        light = self.conditions.light
        trunk = (np.array([82, 62, 44]) * light).tolist()
        cv2.rectangle(drawn, (58, 110), (70, 191), (*trunk, 255), -1)
        for _ in range(60):
            centre = (int(rng.normal(64, 22)), int(rng.normal(66, 24)))
            green = (np.array([60, 110, 44]) * rng.uniform(0.6, 1.2) * light).tolist()
            cv2.circle(drawn, centre, int(rng.integers(8, 20)), (*green, 255), -1)
        wide = float(rng.uniform(2.4, 4.0))
        kerb, at = x - sign * float(rng.uniform(2.0, 3.0)), z + float(rng.uniform(0, 12))
        return [
            Panel(
                origin=(kerb - wide / 2, wide * 1.5, at), along=(wide, 0, 0),
                down=(0, -wide * 1.5, 0), picture=drawn,
            )
        ]  # fmt: skip

    def _car(self, rng: np.random.Generator, x: float, z: float, id_: int) -> list[Panel]:
        """Return the back of a car with its plate."""
        light = self.conditions.light
        paint = np.array(PAINTS[int(rng.integers(len(PAINTS)))]) * light
        drawn = np.zeros((160, 200, 4), np.uint8)
        cv2.rectangle(drawn, (8, 50), (191, 140), (*paint.tolist(), 255), -1)
        cv2.fillConvexPoly(
            drawn,
            np.array([(36, 6), (164, 6), (186, 54), (14, 54)]),
            (*(paint * 0.9).tolist(), 255),
        )
        glass = (np.array([50, 60, 70]) * light).tolist()
        cv2.fillConvexPoly(
            drawn, np.array([(44, 14), (156, 14), (174, 50), (26, 50)]), (*glass, 255)
        )
        for left in (12, 160):
            cv2.rectangle(drawn, (left, 62), (left + 28, 80), (190, 24, 24, 255), -1)
            cv2.rectangle(drawn, (left, 136), (left + 28, 159), (20, 20, 20, 255), -1)
        font = self.fonts[int(rng.integers(len(self.fonts)))]
        text = words.plate(rng)
        lettering.check_glyphs(font, text)
        picture, _, texts = board(
            [(id_, text, False)], font, letter_m=0.09, ink=(20, 20, 22), ground=(240, 220, 90),
            light=max(light, 0.7), margin=0.3,
        )  # fmt: skip
        body = Panel(
            origin=(x - 0.95, 1.5, z), along=(1.9, 0, 0), down=(0, -1.5, 0), picture=drawn,
        )  # fmt: skip
        plate = Panel(
            origin=(x - 0.26, 0.72, z - 0.02), along=(0.52, 0, 0), down=(0, -0.12, 0),
            picture=picture, texts=texts, drives=True,
        )  # fmt: skip
        return [body, plate]

    def _light(self, rng: np.random.Generator) -> float:
        """Draw what comes off a board: at night some are lit."""
        c = self.conditions
        return float(rng.uniform(0.75, 1.0)) if c.night and rng.random() < 0.6 else c.light
