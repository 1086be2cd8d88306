"""Labelled stills as the detector learns from them: a folder -> examples with its classes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from operators.saliency.example import ANYONE, NAMES, Example
from operators.training.stills import (
    CLASSES,
    PERSON,
    class_names,
    labelled,
    labels_of,
    pictures_of,
    read_rows,
)
from pipeline.errors import DriverError

# what data sets call the classes -> index into NAMES, or ANYONE
LABELS = {name: ANYONE if own == PERSON else NAMES.index(own) for name, own in CLASSES.items()}


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
