"""Write text into pictures: a text and a font's file -> letters, by Pillow.

Fonts are those that packages bring (DejaVu with Matplotlib, Roboto and Source with the extra
`text`), or those of a folder.
"""

from collections.abc import Iterable, Iterator
from functools import lru_cache
from importlib.util import find_spec
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SettingsError
from pipeline.extras import LateModule

if TYPE_CHECKING:
    from fontTools import ttLib as tt_lib  # noqa: N813
    from PIL import ImageFont
else:  # optional packages of the extra `text`
    ImageFont, tt_lib = LateModule("PIL.ImageFont"), LateModule("fontTools.ttLib")

PACKAGES = {
    "matplotlib": (
        "mpl-data/fonts/ttf/DejaVuSans.ttf", "mpl-data/fonts/ttf/DejaVuSans-Bold.ttf",
        "mpl-data/fonts/ttf/DejaVuSerif-Bold.ttf", "mpl-data/fonts/ttf/DejaVuSansMono-Bold.ttf",
    ),
    "font_roboto": (
        "files/Roboto-Regular.ttf", "files/Roboto-Bold.ttf", "files/Roboto-Black.ttf",
        "files/Roboto-MediumItalic.ttf",
    ),
    "font_source_sans_pro": ("files/SourceSansPro-Semibold.ttf", "files/SourceSansPro-Bold.ttf"),
    "font_source_serif_pro": ("files/SourceSerifPro-Bold.ttf", "files/SourceSerifPro-Regular.ttf"),
}  # fmt: skip
MANY_SCRIPTS = "DejaVuSans-Bold.ttf"
LETTERS_PX = 64  # size of a font as it is drawn
MOST_FONTS = 64  # of a folder
FILES = (".ttf", ".otf")


def fonts(folder: str = "", texts: Iterable[str] = ()) -> tuple[Path, ...]:
    """Return the files of the fonts of a folder, or of all installed packages.

    Raises `SettingsError` where there is none, and for a file of the folder that is no font or
    lacks a glyph of the texts.
    """
    if folder:
        found = sorted(p for p in Path(folder).glob("*") if p.suffix.lower() in FILES)[:MOST_FONTS]
        if not found:
            raise SettingsError(f"fonts: {folder}: expected .ttf or .otf files, got none")
        for font, text in product(found, tuple(texts)):
            check_glyphs(font, text)
        return tuple(found)
    found = list(_installed())
    if not found:
        raise SettingsError("fonts: no font is installed; pip install 'fovea[text]', or set fonts")
    return tuple(found)


def _installed() -> Iterator[Path]:
    for package, names in PACKAGES.items():
        yield from _files(package, names)


def _files(package: str, names: Iterable[str]) -> list[Path]:
    spec = find_spec(package)
    places = list(spec.submodule_search_locations or ()) if spec else []
    return [path for place in places for name in names if (path := Path(place) / name).is_file()]


def with_many_scripts() -> Path | None:
    """Return the font that knows the scripts of `words.FOREIGN`, None where it is missing."""
    return next((path for path in _installed() if path.name == MANY_SCRIPTS), None)


def check_glyphs(font: Path, text: str) -> None:
    """Raise `SettingsError` for a file that is no font, or lacks a glyph of the text."""
    known = _glyphs(font)
    for letter in text:
        if not letter.isspace() and ord(letter) not in known:
            raise SettingsError(
                f"fonts: {font.name}: expected a glyph for {letter!r} of {text!r}, got none; "
                "choose another font"
            )


@lru_cache(maxsize=2 * MOST_FONTS)
def _glyphs(font: Path) -> frozenset[int]:
    try:
        with tt_lib.TTFont(BytesIO(font.read_bytes()), lazy=True) as opened:
            return frozenset(opened.getBestCmap() or ())
    except Exception as error:  # fontTools raises what its readers raise
        raise SettingsError(f"fonts: {font}: expected a font, got {error}") from error


@lru_cache(maxsize=2 * MOST_FONTS)
def _opened(font: Path) -> "ImageFont.FreeTypeFont":
    try:
        return ImageFont.truetype(str(font), LETTERS_PX)
    except OSError as error:
        raise SettingsError(f"fonts: {font}: expected a font, got {error}") from error


def lettering(font: Path, text: str) -> NDArray[np.uint8]:
    """Return the opacity (h, w) of a text, cut to its ink; `LETTERS_PX` is the font's size."""
    mask = _opened(font).getmask(text)
    wide, high = mask.size
    drawn = np.asarray(mask, np.uint8).reshape(high, wide)
    rows, columns = (np.flatnonzero(drawn.any(axis)) for axis in (1, 0))
    if not len(rows):
        raise SettingsError(f"fonts: {font.name}: expected ink for {text!r}, got none")
    return np.ascontiguousarray(drawn[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
