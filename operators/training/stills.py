"""Labelled stills: a folder with `images/`, `labels/` and `data.yaml` -> pictures and boxes.

A text in `labels/` has a row for each object of the picture of the same name: class number, centre
and size as shares of the picture, as YOLO trainings read them. `data.yaml` names the classes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import read_picture
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest
from pipeline.graph.yaml_lines import YamlFile
from pipeline.wording import shown

PICTURES = (".jpg", ".jpeg", ".png")
MOST_NUMBER = 20_000
PERSON = "person"  # who may be a player or a referee
# what data sets call the classes
CLASSES = {
    "player": "player",
    "goalkeeper": "player",
    "referee": "referee",
    "ball": "ball",
    "sports ball": "ball",
    PERSON: PERSON,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Labelled:
    """A picture and what is in it."""

    picture: NDArray[np.uint8]  # (h, w, 3) RGB
    boxes: NDArray[np.float32]  # (n, 4) xyxy, its pixels
    numbers: NDArray[np.int64]  # (n,) classes of the labels


def class_names(path: Path) -> dict[int, str]:
    """Return the class names of a `data.yaml`, by number; raises `DriverError` with its line."""
    file = YamlFile(path)
    names = file.document.get("names")
    table = dict(enumerate(names)) if isinstance(names, list) else names
    if not isinstance(table, Mapping) or not table:
        raise DriverError(f"{file.at(file.document, 'names')}: names: expected a list of classes")
    for number, name in table.items():
        if not str(number).isdecimal() or name not in CLASSES:
            where = f"{file.at(file.document, 'names')}: names.{number}"
            what = f"expected one of {', '.join(CLASSES)}, got {shown(name)}"
            raise DriverError(f"{where}: {what}")
    return {int(number): str(name) for number, name in table.items()}


def pictures_of(folder: Path) -> list[Path]:
    """Return the pictures that have labels, by name; raises `DriverError` where there are none."""
    found = sorted(p for p in (folder / "images").glob("*") if p.suffix.lower() in PICTURES)
    found = [p for p in found if labels_of(p).is_file()]
    if not found:
        raise DriverError(f"{folder}: expected images/ and labels/ with a text for each, got none")
    return found


def labels_of(picture: Path) -> Path:
    """Return the file with a picture's labels."""
    return picture.parent.parent / "labels" / f"{picture.stem}.txt"


def contents(files: Sequence[Path]) -> str:
    """What is in pictures, their labels and `data.yaml`, as a text that differs where they differ.

    The last says what the labels' numbers mean.
    """
    known = [file.name + file_digest(file) + file_digest(labels_of(file)) for file in files]
    folders = dict.fromkeys(file.parent.parent / "data.yaml" for file in files)
    known += [file_digest(names) for names in folders if names.is_file()]
    return f"{len(files)} files, {sha256(''.join(known).encode()).hexdigest()[:16]}"


def labelled(path: Path) -> Labelled:
    """Read a picture and its labels; raises `DriverError` with file and line."""
    picture = np.asarray(read_picture(path), np.uint8)
    height, width = picture.shape[:2]
    rows = list(read_rows(labels_of(path)))
    shares = np.array([row[1:] for row in rows], np.float32).reshape(-1, 4)
    half = shares[:, 2:] / 2
    boxes = np.hstack([shares[:, :2] - half, shares[:, :2] + half])
    return Labelled(
        picture=picture,
        boxes=(boxes * np.array([width, height] * 2)).astype(np.float32),
        numbers=np.array([row[0] for row in rows], np.int64),
    )


def read_rows(path: Path) -> Iterator[tuple[float, ...]]:
    """Yield class number, centre x, y, width and height of each line that is not empty."""
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        try:
            row = tuple(float(word) for word in line.split())
        except ValueError:
            row = ()
        inside = len(row) == 5 and all(0 <= share <= 1 for share in row[1:])
        if inside and row[0].is_integer() and 0 <= row[0] <= MOST_NUMBER:
            yield row
        elif line.strip():
            what = "a class number and four shares of 0..1"
            raise DriverError(f"{path}:{number + 1}: expected {what}, got {line[:60]!r}")
