"""Labels of texts in pictures: a file of a data set in, outlines and transcriptions out.

Read are ICDAR-2013 and -2015 (`gt_img_1.txt`), labelme (`img_1.json`), Total-Text
(`poly_gt_img1.txt`) and TextOCR (one JSON file for all pictures).
"""

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.texts.files import Place, read_json, read_text
from pipeline.errors import DriverError

ILLEGIBLE = "###"
MOST_TEXTS = 10_000  # of a picture
MOST_LETTERS = 500  # of a text
MOST_LINE = 20_000  # characters of a text with its outline
TOTAL_TEXT = re.compile(
    r"x: \[\[(?P<x>[-\d\s]*)\]\], y: \[\[(?P<y>[-\d\s]*)\]\], ornt: \[u?'?[\w#]*'?\]"
    r", transcriptions: \[u?(?P<quote>['\"])(?P<text>.*)(?P=quote)\]\s*"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Label:
    """One text of a picture."""

    outline: NDArray[np.float32]  # (n, 2) pixels, n >= 3
    text: str  # `ILLEGIBLE` where the data set says that it is not to be read


def read_icdar(path: Path) -> list[Label]:
    """Read `x1,y1,…,x4,y4,text` (2015) or `left top right bottom "text"` (2013), a text a line.

    A transcription may hold commas. Raises `DriverError` with the line.
    """
    found = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        where = f"{path}:{number}"
        if len(line) > MOST_LINE:
            raise DriverError(f"{where}: expected a line of at most {MOST_LINE} characters")
        cells = next(csv.reader([line], delimiter=" ", skipinitialspace=True))
        if len(cells) == 5 and not line.split(",")[0].lstrip("-").isdigit():
            left, top, right, low = _numbers(cells[:4], where)
            corners = [left, top, right, top, right, low, left, low]
            found.append(_label(corners, cells[4], where))
            continue
        parts = line.split(",", 8)
        if len(parts) == 5:
            left, top, right, low = _numbers(parts[:4], where)
            corners = [left, top, right, top, right, low, left, low]
            found.append(_label(corners, parts[4].strip().strip('"'), where))
        elif len(parts) == 9:
            found.append(_label(_numbers(parts[:8], where), parts[8], where))
        else:
            raise DriverError(f"{where}: expected x1,y1,…,x4,y4,text, got {line[:60]!r}")
    return _few(found, path)


def read_labelme(path: Path) -> list[Label]:
    """Read `shapes[].points` and `.label`; raises `DriverError` with the line of the shape."""
    shapes = _part(read_json(path), "shapes", list, Place(path))
    found = []
    for number, shape in enumerate(shapes):
        where = Place(path) / "shapes" / number
        points = _part(shape, "points", list, where)
        text = _part(shape, "label", str, where)
        try:
            flat = [value for x, y in points for value in (x, y)]
        except (TypeError, ValueError) as error:
            raise DriverError(f"{where / 'points'}: expected pairs x, y") from error
        found.append(_label(_numbers(flat, where), text, where))
    return _few(found, path)


def read_total_text(path: Path) -> list[Label]:
    """Read `x: [[…]], y: [[…]], ornt: [u'm'], transcriptions: [u'…']`, a text a line or on two.

    Raises `DriverError` with the line.
    """
    found, text, first = [], "", 1
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not text:
            first = number
        if len(text) + len(line) > MOST_LINE:
            raise DriverError(f"{path}:{first}: expected a text of at most {MOST_LINE} characters")
        text = f"{text} {line}".strip()  # long rows of numbers are broken
        if not text or "transcriptions" not in text:
            continue
        where = f"{path}:{first}"
        match = TOTAL_TEXT.fullmatch(re.sub(r"\s+", " ", text))
        if match is None:
            raise DriverError(f"{where}: expected x: [[…]], y: [[…]], …, got {text[:60]!r}")
        xs, ys = match["x"].split(), match["y"].split()
        if len(xs) != len(ys):
            raise DriverError(f"{where}: expected as many x as y, got {len(xs)} and {len(ys)}")
        flat = [value for pair in zip(xs, ys, strict=True) for value in pair]
        said = ILLEGIBLE if match["text"] == "#" else match["text"]
        found.append(_label(_numbers(flat, where), said, where))
        text = ""
    if text:
        raise DriverError(f"{path}:{first}: expected transcriptions, got {text[:60]!r}")
    return _few(found, path)


def read_textocr(path: Path) -> dict[str, list[Label]]:
    """Read TextOCR: the labels by file name; boxes come from `points`, a text `.` is illegible.

    Raises `DriverError` with the line of the annotation.
    """
    document, whole = read_json(path), Place(path)
    pictures = _part(document, "imgs", dict, whole)
    texts = _part(document, "anns", dict, whole)
    names: dict[str, str] = {}
    found: dict[str, list[Label]] = {}
    for id_, picture in pictures.items():
        name = Path(_part(picture, "file_name", str, whole / "imgs" / id_)).name
        names[id_], found[name] = name, []
    for key, row in texts.items():
        where = whole / "anns" / key
        picture = str(_part(row, "image_id", str, where))
        if picture not in names:
            raise DriverError(f"{where}: expected an image_id of imgs, got {picture!r}")
        text = _part(row, "utf8_string", str, where)
        corners = _numbers(_part(row, "points", list, where), where)
        found[names[picture]].append(_label(corners, ILLEGIBLE if text == "." else text, where))
    return found


READERS = {
    "gt_{}.txt": read_icdar, "{}.txt": read_icdar, "{}.json": read_labelme,
    "poly_gt_{}.txt": read_total_text,
}  # fmt: skip


def labels_beside(picture: Path) -> list[Label] | None:
    """Return the labels in a file beside a picture or in its folder's sibling; None without any."""
    found = _beside(picture)
    return found[1](found[0]) if found else None


def labels_file(picture: Path) -> Path | None:
    """Return the file that `labels_beside` reads; None without any."""
    found = _beside(picture)
    return found[0] if found else None


def _beside(picture: Path) -> tuple[Path, Callable[[Path], list[Label]]] | None:
    folder = picture.parent
    for place in (folder, folder.parent / "labels", folder.parent / "gt"):
        for name, read in READERS.items():
            if (file := place / name.format(picture.stem)).is_file():
                return file, read
    return None


def _part(document: Any, name: str, kind: type, where: Place) -> Any:
    found = document.get(name) if isinstance(document, dict) else None
    if not isinstance(found, kind):
        raise DriverError(f"{where}: expected {name}, {kind.__name__}, got {str(found)[:60]}")
    return found


def _numbers(cells: list[Any], where: Place | str) -> list[float]:
    try:
        found = [float(cell) for cell in cells]
    except (TypeError, ValueError, OverflowError) as error:
        raise DriverError(f"{where}: expected numbers, got {str(cells)[:60]}") from error
    if not np.isfinite(found).all() or any(abs(value) > 1e6 for value in found):
        raise DriverError(f"{where}: expected pixels, got {str(cells)[:60]}")
    return found


def _label(flat: list[float], text: str, where: Place | str) -> Label:
    if len(flat) < 6 or len(flat) % 2:
        raise DriverError(f"{where}: expected at least three points, got {len(flat)} numbers")
    if len(text) > MOST_LETTERS:
        raise DriverError(f"{where}: expected a text of at most {MOST_LETTERS} letters")
    outline = np.array(flat, np.float32).reshape(-1, 2)
    return Label(outline=outline, text=text.strip() or ILLEGIBLE)


def _few(found: list[Label], path: Path) -> list[Label]:
    if len(found) > MOST_TEXTS:
        raise DriverError(f"{path}: expected at most {MOST_TEXTS} texts, got {len(found)}")
    return found
