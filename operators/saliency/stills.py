"""Read labelled stills: a folder with `images/`, `labels/` and `data.yaml` -> pictures and objects.

A text in `labels/` has a row for each object of the picture of the same name: class number, centre
and size as shares of the picture, as YOLO trainings read them. `data.yaml` names the classes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import read_picture
from operators.saliency.example import ANYONE, BALL, NAMES, Example
from pipeline.errors import DriverError
from pipeline.graph.yaml_lines import YamlFile
from pipeline.wording import shown

PICTURES = (".jpg", ".jpeg", ".png")
MOST_NUMBER = 20_000
# what data sets call the classes; who is only called a person may be a player or a referee
LABELS = {name: index for index, name in enumerate(NAMES)} | {
    "goalkeeper": NAMES.index("player"),
    "sports ball": NAMES.index(BALL),
    "person": ANYONE,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Labelled:
    """A picture and what is in it."""

    picture: NDArray[np.uint8]  # (h, w, 3) RGB
    boxes: NDArray[np.float32]  # (n, 4) xyxy, its pixels
    numbers: NDArray[np.int64]  # (n,) classes of the labels


@dataclass(frozen=True, kw_only=True)
class Stills:
    """Some pictures of a folder."""

    folder: Path
    labels: Mapping[int, int]  # class number of the files -> index into NAMES, or ANYONE
    files: tuple[Path, ...]

    def rows(self, file: Path) -> list[tuple[float, ...]]:
        """The objects as they are written; raises `DriverError` with file and line."""
        rows = list(read_rows(labels_of(file)))
        if unknown := {int(row[0]) for row in rows} - set(self.labels):
            known = ", ".join(str(n) for n in self.labels)
            what = f"expected a class of data.yaml, {known}, got {min(unknown)}"
            raise DriverError(f"{labels_of(file)}: {what}")
        return rows

    def example(self, file: Path) -> Example:
        """A picture with its objects; raises `DriverError` with file and line."""
        labels = [self.labels[int(row[0])] for row in self.rows(file)]
        item = labelled(file)
        return Example(
            picture=item.picture,
            boxes=item.boxes,
            labels=np.array(labels, np.int64),
            ignored=np.zeros(len(labels), np.bool_),
        )


def stills(folder: Path, without: Sequence[str] = (), only: Sequence[str] = ()) -> Stills:
    """Return the stills of a folder, but those whose names begin with one of `without`.

    `only`: those whose names begin with one of these. Raises `DriverError`, with file and line, for
    a folder that has none and for classes that are not those of a soccer match.
    """
    kept = [
        file
        for file in pictures_of(folder)
        if not file.name.startswith(tuple(without))
        and (not only or file.name.startswith(tuple(only)))
    ]
    if not kept:
        raise DriverError(f"{folder}: expected pictures beside those left out, got none")
    labels = {number: LABELS[name] for number, name in class_names(folder / "data.yaml").items()}
    return Stills(folder=folder, labels=labels, files=tuple(kept))


def class_names(path: Path) -> dict[int, str]:
    """Return the class names of a `data.yaml`, by number; raises `DriverError` with its line."""
    file = YamlFile(path)
    names = file.document.get("names")
    table = dict(enumerate(names)) if isinstance(names, list) else names
    if not isinstance(table, Mapping) or not table:
        raise DriverError(f"{file.at(file.document, 'names')}: names: expected a list of classes")
    for number, name in table.items():
        if not str(number).isdecimal() or name not in LABELS:
            where = f"{file.at(file.document, 'names')}: names.{number}"
            what = f"expected one of {', '.join(LABELS)}, got {shown(name)}"
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
