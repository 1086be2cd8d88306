"""A procedural soccer broadcast: seed and frame number -> picture and truth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.limits import check_scene
from drivers.scenes.soccer import ball, figures
from drivers.scenes.soccer.ball_actor import ball_actor
from drivers.scenes.soccer.blend import odd, over
from drivers.scenes.soccer.camera import View, draw_station, draw_style, view_at, zoom
from drivers.scenes.soccer.looks import everybody
from drivers.scenes.soccer.pitch import draw_canvas, draw_turf
from drivers.scenes.soccer.play import Moment, moment
from drivers.scenes.soccer.shadows import cast, contact, draw_light
from drivers.scenes.soccer.skeleton import Pose
from drivers.scenes.soccer.stage import Actor, Cache, actors_at, truth_of
from drivers.source import Annotations
from pipeline.errors import SettingsError

Image = NDArray[np.uint8]

CANVAS_RADIUS_PX = 3500.0, 6000.0  # most at full HD and at any size, for memory and time to open
GRAIN_PX = 960
SPRITE_BYTES = 48 << 20  # kept at 1920x1080; four times as many made no picture faster


class SoccerScene:
    """An endless match, the same for the same seed whatever the order of access.

    `difficulty` 0..1 increases the variation of noise, motion blur and dull light. With `ball`
    False there is no ball, neither in the picture nor in the truth.
    """

    shows = "soccer"

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = (1920, 1080),
        rate_hz: float = 30.0,
        seed: int = 0,
        length: int | None = None,
        difficulty: float = 0.5,
        ball: bool = True,
    ) -> None:
        check_scene(size_px, rate_hz, seed, length)
        if not 0 <= difficulty <= 1:
            raise SettingsError(f"difficulty: expected 0 to 1, got {difficulty}")
        self.size_px = (int(size_px[0]), int(size_px[1]))
        self.rate_hz, self.length = rate_hz, length
        self._seed, self._ball = seed, ball
        self._draw_world(difficulty)
        w, h = self.size_px
        self._layers = np.empty((h, w, 4), np.uint8)  # four channels: twice as fast to warp
        self._buffer = np.empty((h, w, 3), np.uint8)
        self._placed: tuple[int, View, View, list[Actor]] | None = None

    def _draw_world(self, difficulty: float) -> None:
        """Draw everything that holds for the whole match."""
        rng = np.random.default_rng([self._seed, 20])
        self._station, self._style = draw_station(rng), draw_style(rng)
        tint = np.clip(1 + rng.normal(0, 0.03 + 0.05 * difficulty, 3), 0.8, 1.2)
        light = float(rng.uniform(0.95 - 0.35 * difficulty, 1.08))
        self._tint = tint * light
        self._shutter = float(rng.uniform(0.15, 0.35 + 0.5 * difficulty))  # of a frame's time
        larger = zoom(self.size_px)
        self._soft_px = float(rng.uniform(0.2, 0.4 + 0.8 * difficulty)) * larger
        self._light = draw_light(rng)
        usual = self._style.px_per_m * (self._station.y_m - 34) * larger
        radius = min(usual, CANVAS_RADIUS_PX[0] * max(1.0, larger), CANVAS_RADIUS_PX[1])
        turf = draw_turf(rng, self._tint)
        self._canvas = draw_canvas(rng, self._station, turf, radius, light)
        _sharpen(self._canvas.image, float(rng.uniform(0, 0.5 + difficulty)))
        looks = everybody(self._seed)

        def make(who: int, pose: Pose, height_px: int) -> figures.Sprite:
            soft = self._soft_px * height_px / (figures.TALL_M * self._style.px_per_m * larger)
            return figures.draw(looks[who], pose, height_px, self._tint, soft)

        self._sprites = Cache(make, round(SPRITE_BYTES * max(1.0, larger) ** 2))
        self._discs = ball.discs(rng, light * float(rng.uniform(0.72, 1.0)))
        self._grain = _grain(rng, float(rng.uniform(0.7, 2 + 6 * difficulty)), 0.3 + 0.3 * larger)

    def picture(self, index: int) -> Image:
        """Draw frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        view, opened, actors = self._stage(index)
        self._paint_ground(view, opened)
        for actor in actors:
            self._paint_shadow(actor)
        for actor in actors:
            over(self._layers, actor.patch, actor.left, actor.top)
        cv2.cvtColor(self._layers, cv2.COLOR_RGBA2RGB, dst=self._buffer)
        self._add_grain(index)
        return self._buffer

    def truth(self, index: int) -> Annotations:
        """Return the exact truth of frame `index`."""
        return truth_of(self._stage(index)[2], self.size_px)

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def _stage(self, index: int) -> tuple[View, View, list[Actor]]:
        """Return the view, the view when the shutter opened, and the actors in drawing order."""
        if index < 0 or (self.length is not None and index >= self.length):
            frames = "endless" if self.length is None else f"{self.length} frames long"
            raise IndexError(f"frame {index}: the scene is {frames}, counted from 0")
        if self._placed is None or self._placed[0] != index:
            now, view = self._look(index / self.rate_hz)
            opened = self._look((index - self._shutter) / self.rate_hz)
            actors = actors_at(now, view, opened, self._sprites, figures.TALL_M)
            if self._ball:
                actors.append(ball_actor((now, view), opened, self._discs, self._seed))
                actors.sort(key=lambda actor: actor.nearer)
            self._placed = (index, view, opened[1], actors)
        return self._placed[1:]

    def _look(self, time_s: float) -> tuple[Moment, View]:
        now = moment(self._seed, max(time_s, 0.0), self._style.lag_s)
        return now, view_at(self._station, self._style, self.size_px, now.focus, time_s)

    def _paint_ground(self, view: View, opened: View) -> None:
        """Draw the canvas, turned and scaled, and blurred by the camera's movement."""
        m = view.matrix()
        canvas = self._canvas
        to_picture = np.column_stack(
            [m[:, :2] / canvas.radius_px, m[:, :2] @ np.array(canvas.origin) + m[:, 2]]
        )
        cv2.warpAffine(
            canvas.image,
            to_picture,
            self.size_px,
            dst=self._layers,
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        way = opened.matrix() @ np.array([*view.aim, 1]) - np.array(self.size_px) / 2
        kernel = odd(float(way[0])), odd(float(way[1]))
        if kernel != (1, 1):
            cv2.blur(self._layers, kernel, dst=self._layers)

    def _add_grain(self, index: int) -> None:
        """Add noise that is new in every frame: tiles of one picture of noise, from a new place."""
        x, y = np.random.default_rng([self._seed, 21, index]).integers(0, GRAIN_PX // 2, 2)
        tile = self._grain[y : y + GRAIN_PX, x : x + GRAIN_PX]
        for top in range(0, self.size_px[1], GRAIN_PX):
            for left in range(0, self.size_px[0], GRAIN_PX):
                part = self._buffer[top : top + GRAIN_PX, left : left + GRAIN_PX]
                cv2.add(part, tile[: part.shape[0], : part.shape[1]], dst=part)

    def _paint_shadow(self, actor: Actor) -> None:
        """Darken the ground under an actor, and where the sun throws its shadow."""
        small = actor.label == "ball"
        wide, high = (0.13, 0.05) if small else (0.42, 0.12)
        w, h = max(2, round(wide * actor.scale)), max(1, round(high * actor.scale))
        x, y = actor.ground
        depth = min(0.6, self._light.depth * 1.2)
        over(self._layers, contact(w, h, depth), round(x) - 2 * w, round(y) - 2 * h)
        if self._light.sun:
            lift = max(0.0, y - actor.box[3]) if small else 0.0
            feet = (x - actor.left, y - actor.top - lift)
            patch, left, top = cast(actor.patch, feet, self._light, lift)
            over(self._layers, patch, actor.left + left, actor.top + top + round(lift))


def _sharpen(image: Image, amount: float) -> None:
    """Give edges halos in place, as broadcast cameras do."""
    cv2.addWeighted(image, 1 + amount, cv2.GaussianBlur(image, (5, 5), 1.2), -amount, 0, dst=image)


def _grain(rng: np.random.Generator, sigma: float, soft_px: float) -> Image:
    """Return noise above zero, because adding unsigned numbers is four times as fast."""
    side = GRAIN_PX * 3 // 2
    noise = rng.normal(0, 1, (side, side, 3)).astype(np.float32)
    noise = np.asarray(cv2.GaussianBlur(noise, (0, 0), soft_px), np.float32)
    noise *= sigma / noise.std()
    return np.clip(np.round(noise + 2 * sigma), 0, 60).astype(np.uint8)
