"""The match from a mast: seed, frame number and window -> pixels; frame number -> truth."""

from collections import OrderedDict
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from drivers.readout import average
from drivers.scenes.limits import check_scene
from drivers.scenes.soccer import ball as balls
from drivers.scenes.soccer import figures
from drivers.scenes.soccer.ball_actor import ball_actor
from drivers.scenes.soccer.looks import everybody, named
from drivers.scenes.soccer.pitch import draw_turf
from drivers.scenes.soccer.play import Moment, moment
from drivers.scenes.soccer.shirts import shirts_of
from drivers.scenes.soccer.skeleton import Pose
from drivers.scenes.soccer.stage import Actor, Cache, actors_at, truth_of
from drivers.scenes.whole_pitch.conditions import LIGHTS, WEATHERS, draw_conditions
from drivers.scenes.whole_pitch.grain import Grain
from drivers.scenes.whole_pitch.ground import Ground
from drivers.scenes.whole_pitch.layers import Layer
from drivers.scenes.whole_pitch.mast import VIEWS, place
from drivers.scenes.whole_pitch.painting import paint
from drivers.scenes.whole_pitch.shadows import shadows
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

Image = NDArray[np.uint8]

LAG_S = 0.8  # of a camera that turns; this one does not, and the play does not depend on it
USUAL_RADIUS_PX = 3900.0  # pixels per radian at 7680 wide
SPRITE_BYTES = 48 << 20  # kept at 7680 wide
SOFT_PX = 0.45  # of the optics
TRUTHS = ("objects", "shirts")
LEAST_PX = 1.0  # sides of a box; the ball is smaller than that in a small picture
STRIP_PX = 2 << 20  # drawn at a time where a reduction has no short way


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    """What moves, as placed in one frame, the farthest first."""

    index: int
    actors: list[Actor]
    figures: list[Layer]
    shadows: list[Layer] = field(default_factory=list)  # made when they are first looked at


class WholePitchScene:
    """An endless match before a camera that stands still and shows all of the pitch.

    `view` is where it stands: on the main stand or behind a goal. The picture of a frame is never
    made, except by `picture`: sensors read windows. What is in a window at full resolution does
    not depend on the window; an averaged one is the mean, up to the edges of overlapping objects.
    The same seed gives the same match, whatever the view, the light and the order of access.
    `kept_frames` have their people and shadows drawn once, for windows of any of them.

    With `names`, shirts bear names above the numbers. `truth_of` chooses what the truth is of:
    `objects`, people and the ball, or `shirts`, numbers and names on the backs that are seen.
    """

    shows = "soccer"

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = (7680, 4320),
        rate_hz: float = 30.0,
        seed: int = 0,
        length: int | None = None,
        view: str = "main",
        light: str = "sun",
        weather: str = "dry",
        ball: bool = True,
        kept_frames: int = 1,
        names: bool = False,
        truth_of: str = "objects",
    ) -> None:
        check_scene(size_px, rate_hz, seed, length)
        choices = {
            "view": (view, VIEWS), "light": (light, LIGHTS), "weather": (weather, WEATHERS),
            "truth_of": (truth_of, TRUTHS),
        }  # fmt: skip
        for name, (value, known) in choices.items():
            if value not in known:
                raise SettingsError(f"{name}: expected {' or '.join(known)}, got {value!r}")
        if kept_frames < 1:
            raise SettingsError(f"kept_frames: must be at least 1, got {kept_frames}")
        self.size_px = (int(size_px[0]), int(size_px[1]))
        self.rate_hz, self.length = rate_hz, length
        self._seed, self._ball = seed, ball
        self._names, self._truth_of = names, truth_of
        self._draw_world(view, light, weather)
        self._buffer = np.empty((0, 0, 3), np.uint8)
        self._frames: OrderedDict[int, _Frame] = OrderedDict()
        self._kept_frames = kept_frames

    def _draw_world(self, view: str, light: str, weather: str) -> None:
        """Draw everything that holds for the whole match."""
        self._mast = mast = place(np.random.default_rng([self._seed, 43]), view, self.size_px)
        rng = np.random.default_rng([self._seed, 44])
        conditions = draw_conditions(rng, light, weather)
        self._conditions = conditions
        self._lamps = tuple(
            replace(lamp, place_m=tuple(mast.seen(np.array(lamp.place_m)).tolist()))
            for lamp in conditions.lamps
        )
        self._shutter = float(rng.uniform(0.12, 0.4))  # of a frame's time
        turf = draw_turf(rng, conditions.tint)
        self._ground = Ground(mast.view, turf)
        paint(self._ground.canvas, rng, mast, turf, conditions)
        larger = mast.view.radius_px / USUAL_RADIUS_PX
        self._grain = Grain(self._seed, conditions.grain, conditions.drops, larger)
        looks, haze = everybody(self._seed), conditions.haze
        if self._names:
            looks = named(looks, self._seed)
        grey = np.float32(haze * conditions.haze_level / 255)

        def make(who: int, pose: Pose, height_px: int) -> figures.Sprite:
            made = figures.draw(looks[who], pose, height_px, conditions.tint, SOFT_PX)
            if haze:
                image = made.image.astype(np.float32)
                image[..., :3] = image[..., :3] * (1 - haze) + image[..., 3:] * grey
                made = replace(made, image=np.round(image).astype(np.uint8))
            return made

        self._sprites = Cache(make, round(SPRITE_BYTES * float(np.clip(larger, 1, 2)) ** 2))
        bright = float(conditions.tint.mean()) * float(rng.uniform(0.85, 1.0))
        self._discs = balls.discs(rng, bright)

    def window(
        self, index: int, left: int, top: int, width: int, height: int, reduce: int, out: Image
    ) -> None:
        """Fill `out` with a window of frame `index`, averaged over `reduce` x `reduce` pixels."""
        frame = self._placed(index)
        wide, high = self.size_px
        inside = 0 <= left <= wide - width and 0 <= top <= high - height
        if not inside or min(width, height, reduce) < 1 or width % reduce or height % reduce:
            raise DriverError(
                f"whole pitch: expected a window inside {wide}x{high}, sides multiples of {reduce},"
                f" got {width}x{height} at {left}, {top}"
            )
        if Grain.divides(reduce):
            self._draw(frame, left, top, reduce, out)
            return
        rows = max(1, STRIP_PX // (width * reduce))
        for first in range(0, len(out), rows):
            part = out[first : first + rows]
            strip = np.empty((len(part) * reduce, width, 3), np.uint8)
            self._draw(frame, left, top + first * reduce, 1, strip)
            average(strip, part)

    def picture(self, index: int) -> Image:
        """Draw frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end.

        It takes the memory of the whole field, 100 MB for 7680x4320: read windows instead.
        """
        width, height = self.size_px
        self._placed(index)
        if not self._buffer.size:
            self._buffer = np.empty((height, width, 3), np.uint8)
        self.window(index, 0, 0, width, height, 1, self._buffer)
        return self._buffer

    def truth(self, index: int) -> Annotations:
        """Return the exact truth of frame `index`; the ball has id 26."""
        if self._truth_of == "shirts":
            return shirts_of(self._placed(index).actors, self.size_px)
        return truth_of(self._placed(index).actors, self.size_px, LEAST_PX)

    @property
    def kept_bytes(self) -> int:
        """Memory of what is kept from frame to frame: ground, noise, sprites, earlier frames."""
        frames = list(self._frames.values())[:-1]
        layers = [layer for frame in frames for layer in (*frame.figures, *frame.shadows)]
        placed = sum(layer.patch.nbytes for layer in layers)
        return self._ground.nbytes + self._grain.nbytes + self._sprites.nbytes + placed

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def _draw(self, frame: _Frame, left: int, top: int, reduce: int, out: Image) -> None:
        self._ground.read(left, top, reduce, out)
        if not frame.shadows:
            view, depth = self._mast.view, self._conditions.contact
            frame.shadows.extend(shadows(frame.actors, view, self._lamps, depth))
        for layer in (*frame.shadows, *frame.figures):
            layer.paste(out, left, top, reduce)
        self._grain.add(frame.index, left, top, reduce, out)

    def _placed(self, index: int) -> _Frame:
        """Return what moves in a frame; raises `IndexError` past the end."""
        if index < 0 or (self.length is not None and index >= self.length):
            frames = "endless" if self.length is None else f"{self.length} frames long"
            raise IndexError(f"frame {index}: the scene is {frames}, counted from 0")
        if index not in self._frames:
            view = self._mast.view
            now, before = self._play(index), self._play(index - self._shutter)
            actors = actors_at(now, view, (before, view), self._sprites, figures.TALL_M)
            if self._ball:
                actors.append(ball_actor((now, view), (before, view), self._discs, self._seed))
                actors.sort(key=lambda actor: actor.nearer)
            layers = [Layer(patch=a.patch, left=a.left, top=a.top) for a in actors]
            self._frames[index] = _Frame(index=index, actors=actors, figures=layers)
            if len(self._frames) > self._kept_frames:
                self._frames.popitem(last=False)
        self._frames.move_to_end(index)
        return self._frames[index]

    def _play(self, index: float) -> Moment:
        """Return the play at the time of a frame, in the camera's frame of reference."""
        now = moment(self._seed, max(index / self.rate_hz, 0.0), LAG_S)
        return self._mast.moment(now)
