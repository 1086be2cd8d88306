"""A wide field with moving objects: seed, frame number and window -> pixels and truth."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.limits import check_scene
from drivers.scenes.panorama.cutouts import Cutout, Cutouts
from drivers.scenes.panorama.ground import Ground, lawn, photographs
from drivers.scenes.panorama.paths import draw_paths
from drivers.scenes.soccer.play import ASSISTANTS, KEEPERS, LABELS, REFEREE, STRIDE_M
from drivers.scenes.soccer.stage import Actor
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

Image = NDArray[np.uint8]

STEPS = 4080  # places of a cut-out across the field: few enough that reduced ones are kept
ROLL_M = math.pi * 0.222  # ground that the ball covers in one turn
# who is pasted first: the referee, then players of both teams in turn, keepers and assistants
ORDER = (REFEREE, *(team * 10 + n for n in range(10) for team in (0, 1)), *KEEPERS, *ASSISTANTS)


class PanoramaScene:
    """The ball and up to 25 people before a camera that stands still; endless, seeded.

    The ground is laid with the pictures at `path`, a file or a folder; with an empty one it is a
    drawn lawn. A field of any size is read by windows and never made whole, except by `picture`.
    The same seed gives the same bytes, whatever the order of access.
    """

    shows = "soccer"

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = (16_320, 9_184),
        rate_hz: float = 30.0,
        seed: int = 0,
        length: int | None = None,
        path: str = "",
        objects: int = 10,
        person_share: float = 0.1,
        ball_share: float = 0.0125,
    ) -> None:
        check_scene(size_px, rate_hz, seed, length)
        if not 0 <= objects <= len(ORDER):
            raise SettingsError(f"objects: expected 0 to {len(ORDER)}, got {objects}")
        for name, share in (("person_share", person_share), ("ball_share", ball_share)):
            if not 0.001 <= share <= 0.3:
                raise SettingsError(f"{name}: expected 0.001 to 0.3 of the height, got {share}")
        self.size_px = (int(size_px[0]), int(size_px[1]))
        self.rate_hz, self.length = rate_hz, length
        rng = np.random.default_rng([seed, 30])
        tiles = photographs(path, self.size_px) if path else lawn(rng, self.size_px)
        self._ground = Ground(tiles)
        self._who = ORDER[:objects]
        self._paths = draw_paths(seed, objects)
        self._stride = rng.random(objects)  # where each one's steps begin
        height = self.size_px[1]
        self._cutouts = Cutouts(seed, person_share * height, ball_share * height)
        # the room of the points that objects stand on, so that they are inside as a whole
        tall = max(person_share, ball_share) * height
        self._low = np.array([0.55 * tall, 1.1 * tall])
        self._room = np.array([self.size_px[0] - 0.55 * tall, height - 0.25 * tall]) - self._low
        if (self._room <= 0).any():
            wide = self.size_px[0]
            raise SettingsError(
                f"person_share: expected people that fit into {wide}x{height}, got {person_share}"
            )
        self._placed: tuple[int, list[tuple[Actor, Cutout]]] = (-1, [])
        self._step_px = max(1, round(self.size_px[0] / STEPS))
        self._buffer = np.empty((0, 0, 3), np.uint8)

    def window(
        self, index: int, left: int, top: int, width: int, height: int, reduce: int, out: Image
    ) -> None:
        """Fill `out` with a window of frame `index`, averaged over `reduce` x `reduce` pixels."""
        pasted = self._pasted(index)
        wide, high = self.size_px
        inside = 0 <= left <= wide - width and 0 <= top <= high - height
        if not inside or min(width, height, reduce) < 1 or width % reduce or height % reduce:
            raise DriverError(
                f"panorama: expected a window inside {wide}x{high}, sides multiples of {reduce}, "
                f"got {width}x{height} at {left}, {top}"
            )
        self._ground.read(left, top, reduce, out)
        for actor, cutout in pasted:
            cutout.paste(out, actor.left - left, actor.top - top, reduce)

    def picture(self, index: int) -> Image:
        """Draw frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end.

        It takes the memory of the whole field, 450 MB for 16320x9184: read windows instead.
        """
        width, height = self.size_px
        if not self._buffer.size:
            self._buffer = np.empty((height, width, 3), np.uint8)
        self.window(index, 0, 0, width, height, 1, self._buffer)
        return self._buffer

    def truth(self, index: int) -> Annotations:
        """Return the exact truth of frame `index`; the ball has id 1."""
        actors = [actor for actor, _ in self._pasted(index)]
        shares = {actor.id: _visible(actor, actors[k + 1 :]) for k, actor in enumerate(actors)}
        actors.sort(key=lambda actor: actor.id)
        return Annotations(
            boxes=np.array([actor.box for actor in actors], np.float32),
            ids=np.array([actor.id for actor in actors], np.int32),
            labels=tuple(actor.label for actor in actors),
            visibility=np.array([shares[actor.id] for actor in actors], np.float32),
        )

    @property
    def kept_bytes(self) -> int:
        """Memory of the ground and the cut-outs."""
        return self._ground.nbytes + self._cutouts.nbytes

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def _pasted(self, index: int) -> list[tuple[Actor, Cutout]]:
        """Return the objects in the order of drawing, the farthest first."""
        if index < 0 or (self.length is not None and index >= self.length):
            frames = "endless" if self.length is None else f"{self.length} frames long"
            raise IndexError(f"frame {index}: the scene is {frames}, counted from 0")
        if self._placed[0] != index:
            places, speeds = self._paths.at(index / self.rate_hz)
            points = self._low + places * self._room
            speeds = speeds * self._room / self._cutouts.px_per_m
            pasted = [self._paste(n, points[n], speeds[n], index) for n in range(len(points))]
            self._placed = (index, sorted(pasted, key=lambda pair: pair[0].nearer))
        return self._placed[1]

    def _paste(
        self, n: int, point: NDArray[np.float64], speed_m_s: NDArray[np.float64], index: int
    ) -> tuple[Actor, Cutout]:
        """Return object `n`, the ball first, on a point of the ground."""
        cutout, label = self._cut(n, speed_m_s, index / self.rate_hz)
        step = self._step_px
        left, top = (
            round((float(at) - foot) / step) * step
            for at, foot in zip(point, cutout.feet, strict=True)
        )
        x0, y0, x1, y1 = cutout.box
        actor = Actor(
            id=n + 1, label=label, patch=cutout.patch, left=left, top=top,
            box=(left + x0, top + y0, left + x1, top + y1), nearer=float(point[1]),
            ground=(float(point[0]), float(point[1])), scale=self._cutouts.px_per_m,
        )  # fmt: skip
        return actor, cutout

    def _cut(self, n: int, speed_m_s: NDArray[np.float64], time_s: float) -> tuple[Cutout, str]:
        across, down = float(speed_m_s[0]), float(speed_m_s[1])
        pace = math.hypot(across, down)
        if n == 0:
            return self._cutouts.ball(time_s * 1.5 / ROLL_M), "ball"
        who = self._who[n - 1]
        # a stride that does not depend on the past: its rate is that of a usual walk
        phase = (self._stride[n - 1] + time_s * 2.0 / STRIDE_M) % 1.0
        return self._cutouts.person(who, pace, math.atan2(down, across), phase), LABELS[who]


def _visible(actor: Actor, nearer: Sequence[Actor]) -> float:
    """Return the share of an actor that those in front of it leave to be seen."""
    x0, y0, x1, y1 = actor.box
    hiding = [
        other
        for other in nearer
        if other.box[0] < x1 and x0 < other.box[2] and other.box[1] < y1 and y0 < other.box[3]
    ]
    if not hiding:
        return 1.0
    mask = _opaque(actor, actor.box)
    whole = max(1, int(mask.sum()))
    for other in hiding:
        left, right = max(x0, other.box[0]), min(x1, other.box[2])
        top, bottom = max(y0, other.box[1]), min(y1, other.box[3])
        hides = _opaque(other, (left, top, right, bottom))
        mask[top - y0 : bottom - y0, left - x0 : right - x0] &= ~hides
    return float(mask.sum()) / whole


def _opaque(actor: Actor, box: tuple[int, int, int, int]) -> NDArray[np.bool_]:
    """Return which pixels of a box inside the actor's patch belong to it: (h, w)."""
    rows = slice(box[1] - actor.top, box[3] - actor.top)
    alpha = actor.patch[rows, box[0] - actor.left : box[2] - actor.left, 3]
    return np.asarray(alpha >= actor.solid)
