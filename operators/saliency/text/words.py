"""Words on name boards: random state -> flat pictures of a few lines, with the corners of words.

The words are made of random letters: a detector must find text of any language and no text.
"""

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InstallError
from pipeline.extras import LateModule

image_font: Any = LateModule("PIL.ImageFont")  # needs the extra `text`
image_draw: Any = LateModule("PIL.ImageDraw")
image: Any = LateModule("PIL.Image")

PACKAGES = ("font_roboto", "font_source_sans_pro", "font_source_serif_pro", "matplotlib")
FAMILIES = ("Roboto", "SourceSans", "SourceSerif", "DejaVu")
VOWELS, CONSONANTS, DIGITS = "aeiou", "bcdfghjklmnprstvwxyz", "0123456789"
MARGIN_PX = 1.0  # between the ink of a word and its box


@dataclass(frozen=True, kw_only=True, eq=False)
class Board:
    """A flat picture with words; where `alpha` is 0 one sees what is behind it."""

    pixels: NDArray[np.uint8]  # (h, w, 3) RGB
    alpha: NDArray[np.uint8]  # (h, w)
    quads: NDArray[np.float32]  # (n, 4, 2) corners of its words, its pixels


@cache
def fonts() -> tuple[Path, ...]:
    """Return the font files of the installed packages; raises `InstallError` without any."""
    folders = [
        Path(spec.origin).parent
        for spec in map(find_spec, PACKAGES)
        if spec is not None and spec.origin is not None
    ]
    found = sorted({
        path
        for folder in folders
        for path in folder.rglob("*.ttf")
        if path.name.startswith(FAMILIES) and "Display" not in path.name
    })  # fmt: skip
    if not found:
        raise InstallError("text: expected fonts, got none: pip install 'fovea[text]'")
    return tuple(found)


def word(rng: np.random.Generator) -> str:
    """Return letters or digits that look like a word, a number or a plate."""
    kind = rng.random()
    if kind < 0.12:
        return "".join(rng.choice(list(DIGITS), int(rng.integers(1, 5))))
    if kind < 0.2:
        letters = "".join(rng.choice(list(CONSONANTS + VOWELS), int(rng.integers(1, 4)))).upper()
        return letters + "".join(rng.choice(list(DIGITS), int(rng.integers(1, 4))))
    length = int(np.clip(rng.normal(5.5, 2.5), 1, 13))
    letters = "".join(
        rng.choice(list(VOWELS if (k + int(kind * 99)) % 2 else CONSONANTS)) for k in range(length)
    )
    case = rng.random()
    letters = letters.upper() if case < 0.5 else letters.title() if case < 0.85 else letters
    return letters + ("" if rng.random() < 0.93 else str(rng.choice(list(".,:!&'-"))))


def colours(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the colours of a board and of its text, (3,) each, mostly of good contrast."""
    least = 90 if rng.random() < 0.8 else 35
    while True:
        pair = rng.integers(0, 256, (2, 3)).astype(np.float32)
        for row in range(2):
            if rng.random() < 0.45:  # white, black and grey are common
                pair[row] = rng.choice([8, 30, 60, 190, 225, 250])
        if abs(float((pair[0] - pair[1]) @ [0.3, 0.59, 0.11])) >= least:
            return pair[0], pair[1]


def board(rng: np.random.Generator, height_px: float) -> Board:
    """Draw one to three lines whose letters are about `height_px` high."""
    lines = int(rng.choice([1, 1, 1, 2, 2, 3, 4]))
    most = 2 if height_px > 30 else 4
    rows = [[word(rng) for _ in range(int(rng.integers(1, most + 1)))] for _ in range(lines)]
    font = fonts()[int(rng.integers(len(fonts())))]
    pad, gap = height_px * rng.uniform(0.25, 1.2), height_px * rng.uniform(0.3, 0.9)
    placed, width, top = [], 0.0, pad
    for row in rows:
        size = max(6, round(height_px * 1.38 * rng.uniform(0.8, 1.25)))
        loaded = image_font.truetype(str(font), size)
        left = 0.0
        spots = []
        for text in row:
            spots.append((text, left, top, loaded))
            left += float(loaded.getlength(text)) + size * rng.uniform(0.22, 0.45)
        placed.append((spots, left))
        width, top = max(width, left), top + size * 0.78 + gap
    w, h = int(width + 2 * pad), int(top - gap + pad + height_px * 0.25)
    middle = rng.random() < 0.6
    return _painted(rng, (w, h), pad, [
        (text, x + pad + ((width - total) / 2 if middle else 0), y, loaded)
        for spots, total in placed
        for text, x, y, loaded in spots
    ])  # fmt: skip


def _painted(
    rng: np.random.Generator,
    size_px: tuple[int, int],
    pad: float,
    spots: list[tuple[str, float, float, Any]],
) -> Board:
    back, fore = colours(rng)
    mask = image.new("L", size_px, 0)
    pen = image_draw.Draw(mask)
    quads = []
    for text, x, y, loaded in spots:
        # letters of a line stand on a common base whichever they are
        pen.text((x, y), text, fill=255, font=loaded, anchor="la")
        x0, y0, x1, y1 = pen.textbbox((x, y), text, font=loaded, anchor="la")
        x0, y0, x1, y1 = x0 - MARGIN_PX, y0 - MARGIN_PX, x1 + MARGIN_PX, y1 + MARGIN_PX
        quads.append([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    ink = np.asarray(mask, np.float32)[..., None] / 255
    plain = np.tile(back, (*ink.shape[:2], 1))
    if rng.random() < 0.3:  # lit from one side
        fall = np.linspace(rng.uniform(0.6, 1), rng.uniform(0.8, 1.2), ink.shape[1])
        plain = np.ascontiguousarray(plain * fall[None, :, None], np.float32)
    if rng.random() < 0.3:
        edge = max(1, round(pad * 0.2))
        cv2.rectangle(
            plain, (edge, edge), (size_px[0] - edge - 1, size_px[1] - edge - 1),
            tuple(float(v) for v in fore), max(1, edge // 2),
        )  # fmt: skip
    pixels = np.clip(plain * (1 - ink) + fore * ink, 0, 255).astype(np.uint8)
    bare = rng.random() < 0.3  # letters fixed to the wall itself
    alpha = (ink[..., 0] * 255 if bare else np.full(ink.shape[:2], 255)).astype(np.uint8)
    return Board(pixels=pixels, alpha=alpha, quads=np.array(quads, np.float32))
