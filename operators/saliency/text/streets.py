"""Pictures that look roughly like streets, with and without words: random state -> picture.

They teach what is text and what only looks like it: windows, bricks, railings, leaves, crossings.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.text.quads import areas, upright
from operators.saliency.text.words import Board, board

FULL_PX = (1280, 720)  # width, height
LETTERS_PX = (6.0, 70.0)  # height of letters
LEAST_SEEN = 0.55  # share of a word that must be seen to be wanted
Pixels = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A picture and the words in it."""

    pixels: Pixels  # (h, w, 3) RGB
    quads: NDArray[np.float32]  # (n, 4, 2) corners, its pixels
    ignored: NDArray[np.bool_]  # (n,) may be found or not


def street(rng: np.random.Generator, behind: Picture | None = None) -> Picture:
    """Draw one picture of `FULL_PX`; `behind` is a photograph to draw upon, with its own texts."""
    pixels = backdrop(rng) if behind is None else behind.pixels.copy()
    count = int(rng.choice([0, 2, 4, 6, 9, 13], p=[0.06, 0.14, 0.2, 0.25, 0.2, 0.15]))
    quads: list[NDArray[np.float32]] = []
    taken = np.zeros((0, 4), np.float32)
    for _ in range(count):
        height = float(np.exp(rng.uniform(*np.log(LETTERS_PX))))
        made = board(rng, height)
        for _ in range(8):
            target = _place(rng, made)
            around = upright(target[None])[0]
            if not _meets(around, taken) and _fits(around):
                quads.append(_stick(pixels, made, target))
                taken = np.concatenate([taken, around[None]])
                break
    found = np.concatenate([np.zeros((0, 4, 2), np.float32), *quads])
    hidden = _hide(pixels, rng)
    seen = np.array([_share(quad, hidden) for quad in found], np.float32)
    if behind is None:
        return Picture(pixels=pixels, quads=found, ignored=seen < LEAST_SEEN)
    return Picture(
        pixels=pixels,
        quads=np.concatenate([found, behind.quads]),
        ignored=np.concatenate([seen < LEAST_SEEN, behind.ignored]),
    )


def backdrop(rng: np.random.Generator) -> Pixels:
    """Draw a street without words."""
    width, height = FULL_PX
    coarse = rng.uniform(20, 235, (int(rng.integers(2, 7)), int(rng.integers(2, 9)), 3))
    coarse = coarse.mean(2, keepdims=True) * 0.6 + coarse * 0.4
    smooth = cv2.resize(coarse.astype(np.uint8), FULL_PX, interpolation=cv2.INTER_CUBIC)
    pixels = np.asarray(smooth, np.uint8)
    for _ in range(int(rng.integers(3, 9))):
        _stick(pixels, _wall(rng), _place_wall(rng))
    for _ in range(int(rng.integers(0, 25))):
        _thing(pixels, rng)
    if rng.random() < 0.5:  # leaves
        noise = rng.integers(0, 256, (height // 6, width // 6), np.uint8)
        leaves = cv2.resize(noise, FULL_PX, interpolation=cv2.INTER_CUBIC)
        crowns = cv2.GaussianBlur(noise, (0, 0), 10 * rng.random() + 3)
        least = float(np.quantile(crowns, rng.uniform(0.7, 0.95)))
        mask = (leaves > 128) & (cv2.resize(crowns, FULL_PX) > least)
        pixels[mask] = (pixels[mask] * 0.3 + rng.integers(0, 150, 3) * 0.7).astype(np.uint8)
    return pixels


def _wall(rng: np.random.Generator) -> Board:
    """A facade of windows, of bricks or of bars, as a board without words."""
    height, width = (int(n) for n in rng.integers(120, 420, 2))
    colour = rng.integers(30, 230) + rng.normal(0, 18, 3)
    pixels = np.clip(np.broadcast_to(colour, (height, width, 3)), 0, 255).astype(np.uint8)
    noise = rng.integers(0, 24, (height, width, 1), np.uint8)
    cv2.add(pixels, np.repeat(noise, 3, 2), dst=pixels)
    shade = tuple(float(np.clip(v + rng.choice([-70, -35, 45, 80]), 0, 255)) for v in colour)
    kind = rng.random()
    if kind < 0.45:  # windows
        across, down = (int(n) for n in rng.integers(14, 90, 2))
        share = rng.uniform(0.4, 0.75)
        for y in range(down // 4, height, down):
            for x in range(across // 4, width, across):
                lit = tuple(float(v) for v in rng.integers(0, 255, 3)) if rng.random() < 0.1 else ()
                end = (x + int(across * share), y + int(down * share))
                cv2.rectangle(pixels, (x, y), end, lit or shade, -1)
    elif kind < 0.6:  # bricks
        step = int(rng.integers(5, 22))
        pixels[::step] = shade
        for row, y in enumerate(range(0, height, step)):
            pixels[y : y + step, (row % 2) * step :: 2 * step] = shade
    elif kind < 0.75:  # bars, blinds, a crossing
        step, thick = int(rng.integers(6, 40)), int(rng.integers(2, 12))
        for x in range(0, width, step):
            pixels[:, x : x + thick] = shade
        if rng.random() < 0.4:
            pixels = np.ascontiguousarray(pixels.transpose(1, 0, 2))
    alpha = np.full(pixels.shape[:2], 255, np.uint8)
    return Board(pixels=pixels, alpha=alpha, quads=np.zeros((0, 4, 2), np.float32))


def _thing(pixels: Pixels, rng: np.random.Generator) -> None:
    """A disc, a bar, a line or a rectangle somewhere: lamps, wheels, poles, wires."""
    x, y = (int(rng.integers(side)) for side in FULL_PX)
    size = int(np.exp(rng.uniform(np.log(3), np.log(90))))
    colour = tuple(float(v) for v in rng.integers(0, 256, 3))
    thick = int(rng.choice([-1, -1, 1, 2, 4]))
    kind = rng.random()
    if kind < 0.3:
        cv2.circle(pixels, (x, y), size, colour, thick, cv2.LINE_AA)
    elif kind < 0.6:
        wide = int(size * rng.uniform(0.3, 4))
        cv2.rectangle(pixels, (x, y), (x + wide, y + size), colour, thick)
    else:
        away = rng.normal(0, 300, 2)
        end = (int(x + away[0]), int(y + away[1]))
        cv2.line(pixels, (x, y), end, colour, max(1, abs(thick)), cv2.LINE_AA)


def _place(rng: np.random.Generator, made: Board) -> NDArray[np.float32]:
    """Where a board hangs: its corners (4, 2) in the picture."""
    height, width = made.pixels.shape[:2]
    angle = rng.normal(0, 0.06) if rng.random() < 0.85 else rng.uniform(-1.3, 1.3)
    narrow = 1.0 if rng.random() < 0.4 else rng.uniform(0.35, 1)  # seen from the side
    far = 1.0 + (rng.uniform(-0.3, 0.3) if narrow < 1 else 0.0)
    slope = rng.normal(0, 0.12) * (1 - narrow) * 3
    w, h = width * narrow / 2, height / 2
    flat = np.array([[-w, -h], [w, -h * far], [w, h * far], [-w, h]], np.float32)
    flat[:, 1] += flat[:, 0] * slope
    sine, cosine = np.sin(angle), np.cos(angle)
    target = flat @ np.array([[cosine, sine], [-sine, cosine]])
    target += rng.uniform([0, 0], FULL_PX)
    return np.asarray(target, np.float32)


def _place_wall(rng: np.random.Generator) -> NDArray[np.float32]:
    """Where a wall stands: its corners (4, 2) in the picture."""
    left, right = np.sort(rng.uniform(-200, FULL_PX[0] + 200, 2))
    tops, bottoms = rng.uniform(-200, 420, 2), rng.uniform(300, 900, 2)
    target = np.array([[left, tops[0]], [right, tops[1]], [right, bottoms[1]], [left, bottoms[0]]])
    return target.astype(np.float32)


def _stick(pixels: Pixels, made: Board, target: NDArray[np.float32]) -> NDArray[np.float32]:
    """Put a board on the picture with its corners at `target`; returns the corners of its words."""
    height, width = made.pixels.shape[:2]
    low = np.clip(np.floor(target.min(0)), 0, FULL_PX).astype(int)
    high = np.clip(np.ceil(target.max(0)) + 1, 0, FULL_PX).astype(int)
    flat = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    matrix = cv2.getPerspectiveTransform(flat, target)
    if (high > low).all():
        # corners are of edges; OpenCV maps pixels by their number, whose centres lie at halves
        move = _moved(-low - 0.5) @ matrix @ _moved(np.full(2, 0.5))
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        part = pixels[low[1] : high[1], low[0] : high[0]]
        if made.alpha.min() == 255:  # much faster, and most are
            whole = np.ascontiguousarray(part)
            cv2.warpPerspective(
                made.pixels, move, size, dst=whole, borderMode=cv2.BORDER_TRANSPARENT
            )
            part[:] = whole
        else:
            seen = cv2.warpPerspective(made.pixels, move, size, borderMode=cv2.BORDER_REPLICATE)
            cover = cv2.warpPerspective(made.alpha, move, size)[..., None].astype(np.float32) / 255
            part[:] = (part * (1 - cover) + seen * cover).astype(np.uint8)
    if not len(made.quads):
        return made.quads
    return np.asarray(cv2.perspectiveTransform(made.quads, matrix), np.float32)


def _moved(by: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[1, 0, by[0]], [0, 1, by[1]], [0, 0, 1]], np.float64)


def _meets(box: NDArray[np.float32], taken: NDArray[np.float32]) -> bool:
    low, high = np.maximum(box[:2], taken[:, :2]), np.minimum(box[2:], taken[:, 2:])
    return bool((high > low).all(1).any())


def _fits(box: NDArray[np.float32]) -> bool:
    width, height = FULL_PX
    inside = np.clip(box, 0, [width, height, width, height])
    share = np.prod(inside[2:] - inside[:2]) / max(np.prod(box[2:] - box[:2]), 1.0)
    return bool(share > 0.6)


def _hide(pixels: Pixels, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Put poles and blobs before everything; returns where."""
    before = np.zeros(pixels.shape[:2], np.uint8)
    for _ in range(int(rng.choice([0, 0, 1, 2, 4]))):
        x, y = int(rng.integers(FULL_PX[0])), int(rng.integers(FULL_PX[1]))
        if rng.random() < 0.6:
            wide = int(rng.integers(4, 26))
            cv2.line(before, (x, 0), (x + int(rng.normal(0, 30)), FULL_PX[1]), 255, wide)
        else:
            axes = (int(rng.integers(20, 120)), int(rng.integers(20, 90)))
            cv2.ellipse(before, (x, y), axes, 0, 0, 360, 255, -1)
    mask = before > 0
    pixels[mask] = rng.integers(0, 200, 3).astype(np.uint8)
    return mask


def _share(quad: NDArray[np.float32], hidden: NDArray[np.bool_]) -> float:
    """Share of a word that is in the picture and not hidden."""
    x0, y0, x1, y1 = upright(quad[None])[0]
    steps = np.linspace(0.05, 0.95, 8)
    x = (x0 + (x1 - x0) * steps).astype(int)
    y = (y0 + (y1 - y0) * steps).astype(int)
    inside = (x >= 0) & (x < FULL_PX[0]), (y >= 0) & (y < FULL_PX[1])
    if not inside[0].any() or not inside[1].any() or areas(quad[None])[0] < 1:
        return 0.0
    seen = ~hidden[np.ix_(y[inside[1]], x[inside[0]])]
    return float(seen.mean() * inside[0].mean() * inside[1].mean())
