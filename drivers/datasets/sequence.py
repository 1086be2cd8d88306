"""Folders of numbered pictures as MOT and SoccerNet keep them: seqinfo.ini and rows of boxes.

Format: `../img1/000001.jpg …`, `seqinfo.ini` with a section [Sequence], and text files of rows
`frame (from 1), id, left, top, width, height, …`.
"""

import configparser
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import check_size, read_picture
from drivers.regular_file import read_text
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

MOST_INI_BYTES, MOST_ROWS_BYTES = 1 << 20, 1 << 28  # of a file
_SPAN = re.compile(r"([0-9]+)(?:-([0-9]+))?")


@dataclass(frozen=True, kw_only=True)
class SequenceInfo:
    """The contents of seqinfo.ini."""

    name: str
    folder: Path  # of the pictures
    suffix: str
    size_px: tuple[int, int]
    rate_hz: float
    length: int

    def picture_path(self, index: int) -> Path:
        """Return the path of a picture; the files are numbered from 1."""
        return self.folder / f"{index + 1:06d}{self.suffix}"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of gt.txt or det.txt."""

    line: int  # from 1
    index: int  # frame, from 0
    id: int
    box: tuple[float, float, float, float]  # xyxy, pixels
    rest: tuple[float, ...]  # the columns after the box


class NumberedPictures:
    """The pictures of a sequence, decoded one at a time into one buffer."""

    def __init__(self, info: SequenceInfo) -> None:
        self._info = info
        width, height = info.size_px
        self._buffer = np.empty((height, width, 3), np.uint8)
        for index in {0, info.length - 1}:
            if not info.picture_path(index).is_file():
                raise DriverError(
                    f"{info.picture_path(index)}: expected picture {index + 1} of {info.length} "
                    "that seqinfo.ini promises, got no such file"
                )

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        if not 0 <= index < self._info.length:
            raise IndexError(f"{self._info.name}: no frame {index} in {self._info.length}")
        return read_picture(self._info.picture_path(index), self._buffer)


def span(text: str) -> tuple[int, int]:
    """Parse a range of frames A-B, counted from 1 as the files are, or a single frame A.

    Raises `SettingsError`, which is a ValueError, as argparse requires.

    >>> span("251-375"), span("7")
    ((251, 375), (7, 7))
    """
    typed = _SPAN.fullmatch(text)
    first, last = (int(typed[1]), int(typed[2] or typed[1])) if typed else (0, 0)
    if not 1 <= first <= last:
        raise SettingsError(f"frames: expected A-B, counted from 1, got {text!r}")
    return first, last


def read_ini(path: Path) -> configparser.SectionProxy:
    """Return the section [Sequence]; keys keep their case and values their `;`."""
    parser = configparser.ConfigParser(
        delimiters=("=",), comment_prefixes=("#",), inline_comment_prefixes=None, interpolation=None
    )
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(read_text(path, MOST_INI_BYTES, "utf-8-sig"), str(path))
    except (configparser.Error, UnicodeDecodeError) as error:
        raise DriverError(f"{path}: not an ini file: {' '.join(str(error).split())}") from error
    if "Sequence" not in parser:
        raise DriverError(f"{path}: expected a section [Sequence], got {parser.sections()}")
    return parser["Sequence"]


def read_info(folder: Path) -> SequenceInfo:
    """Read seqinfo.ini of a sequence folder; raises `DriverError` naming file and key."""
    path = folder / "seqinfo.ini"
    if not path.is_file():
        got = "a file" if folder.is_file() else "no such folder"
        got = "one without seqinfo.ini" if folder.is_dir() else got
        what = "expected the folder of a sequence (seqinfo.ini, img1/)"
        raise DriverError(f"{folder}: {what}, got {got}")
    section = read_ini(path)
    width, height, length = (_whole(path, section, k) for k in ("imWidth", "imHeight", "seqLength"))
    check_size(path, (width, height))
    return SequenceInfo(
        name=section.get("name", folder.name),
        folder=folder / _inside(path, section.get("imDir", "img1")),
        suffix=_suffix(path, section.get("imExt", ".jpg")),
        size_px=(width, height),
        rate_hz=_positive(path, section, "frameRate"),
        length=length,
    )


def read_rows(path: Path, *, columns: int) -> Iterator[Row]:
    """Yield the rows of a gt.txt or det.txt with at least so many columns; skip blank lines.

    Raises `DriverError` naming file and line.
    """
    try:
        text = read_text(path, MOST_ROWS_BYTES, "ascii")
    except UnicodeDecodeError as error:
        raise DriverError(f"{path}: expected rows of numbers, got binary data") from error
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            yield _row(f"{path}:{number}", number, line.strip(), columns)


def by_frame(rows: list[Row], labels: list[str], visible: list[float]) -> dict[int, Annotations]:
    """Return the truth per frame index from rows with their labels and visible shares."""
    members: dict[int, list[int]] = {}
    for place, row in enumerate(rows):
        members.setdefault(row.index, []).append(place)
    return {
        index: Annotations(
            boxes=np.array([rows[p].box for p in places], np.float32),
            ids=np.array([rows[p].id for p in places], np.int32),
            labels=tuple(labels[p] for p in places),
            visibility=np.array([visible[p] for p in places], np.float32),
        )
        for index, places in members.items()
    }


def no_objects() -> Annotations:
    """Return the truth of an empty frame."""
    return Annotations(
        boxes=np.zeros((0, 4), np.float32),
        ids=np.zeros(0, np.int32),
        labels=(),
        visibility=np.zeros(0, np.float32),
    )


def _row(where: str, number: int, line: str, columns: int) -> Row:
    try:
        values = [float(value) for value in line.split(",")]
    except ValueError as error:
        raise DriverError(f"{where}: expected numbers and commas, got {line[:80]!r}") from error
    if len(values) < columns:
        raise DriverError(f"{where}: expected at least {columns} columns, got {len(values)}")
    if not all(abs(value) < 2**31 for value in values):
        raise DriverError(f"{where}: expected finite numbers, got {line[:80]!r}")
    frame, id_, left, top, width, height, *rest = values
    if frame < 1 or not (frame.is_integer() and id_.is_integer()):
        raise DriverError(
            f"{where}: expected a frame from 1 and a whole id, got {frame:g}, {id_:g}"
        )
    if not (width > 0 and height > 0):
        raise DriverError(f"{where}: expected a box with area, got {width:g} x {height:g}")
    return Row(
        line=number,
        index=int(frame) - 1,
        id=int(id_),
        box=(left, top, left + width, top + height),
        rest=tuple(rest),
    )


def _whole(path: Path, section: configparser.SectionProxy, key: str) -> int:
    value = _positive(path, section, key)
    if not value.is_integer():
        raise DriverError(f"{path}: {key}: expected a whole number, got {section[key]!r}")
    return int(value)


def _inside(path: Path, name: str) -> Path:
    """Return a folder below that of the sequence: a recording names no other files."""
    found = Path(name)
    if found.is_absolute() or ".." in found.parts or "\0" in name:
        raise DriverError(f"{path}: imDir: expected a folder beside this file, got {name!r}")
    return found


def _suffix(path: Path, text: str) -> str:
    if not re.fullmatch(r"\.\w{1,8}", text):
        raise DriverError(f"{path}: imExt: expected an ending such as .jpg, got {text!r}")
    return text


def _positive(path: Path, section: configparser.SectionProxy, key: str) -> float:
    text = section.get(key, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e6:
        got = repr(text) if key in section else "no such key"
        raise DriverError(f"{path}: {key}: expected a number above 0, got {got}")
    return value
