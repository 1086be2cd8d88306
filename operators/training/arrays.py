"""Files of arrays with a record of how they were made; written atomically."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.training.identity import Identity, differing
from pipeline.errors import DriverError
from pipeline.whole_file import write_whole

Arrays = dict[str, NDArray[Any]]
MADE_WITH = "made_with"
Source = TypeVar("Source")  # what a file is made of


def write(
    path: Path, arrays: Mapping[str, NDArray[Any]], made: Identity,
    pictures: NDArray[np.uint8] | None = None,
) -> None:  # fmt: skip
    """Keep arrays, what they were made with, and pictures beside them, as `mapped` reads them.

    A training that has mapped the former pictures keeps them. Raises `OSError`, with the file.
    """
    if pictures is not None:
        path.unlink(missing_ok=True)  # it would say that the new pictures are as the former were
        kept = BytesIO()  # into a file on a full disk, NumPy does not say what is wrong
        np.save(kept, pictures, allow_pickle=False)
        write_whole(path.with_suffix(".npy"), kept.getbuffer())
    told, whole = {MADE_WITH: np.array(json.dumps(dict(made)))}, BytesIO()
    np.savez(whole, allow_pickle=False, **arrays, **told)
    write_whole(path, whole.getbuffer())


def read(path: Path) -> Arrays:
    """All arrays of a file; raises `DriverError` for one that is damaged or is none of these."""
    return _read(path)[0]


def outdated(
    paths: Iterable[Path], made: Identity | Callable[[Path], Identity],
    say: Callable[[str], None], *, with_pictures: bool = False,
) -> list[Path]:  # fmt: skip
    """Return the files to make again: missing, damaged, or made otherwise; report why.

    `made` may differ from file to file. `with_pictures`: each has pictures beside it, as `mapped`
    reads them.
    """
    found, reasons = [], Counter[str]()
    for path in paths:
        if path.exists():
            reason = _fault(path, made(path) if callable(made) else made, with_pictures)
            if not reason:
                continue
            reasons[f"{path.parent}: made anew: {reason}"] += 1
        found.append(path)
    for reason, count in reasons.items():
        say(f"{reason} ({count} file{'s' * (count > 1)})")
    return found


def claim(wanted: dict[Path, Source], file: Path, source: Source) -> None:
    """Note what a file is made of; raises `DriverError` where that is something else already."""
    other = wanted.setdefault(file, source)
    if other != source:
        raise DriverError(
            f"{source}: expected a name of its own, got that of {other}: both would be kept as "
            f"{file.name}; rename one of them, or its folder"
        )


def mapped(path: Path) -> NDArray[np.uint8]:
    """Map the pictures beside a file into memory; raises `DriverError` for missing or cut ones."""
    beside = path.with_suffix(".npy")
    try:
        return np.load(beside, mmap_mode="r")  # type: ignore[no-any-return]
    except (OSError, EOFError, ValueError) as error:
        raise DriverError(f"{beside}: expected pictures, got {error}") from error


def _fault(path: Path, made: Identity, with_pictures: bool) -> str:
    try:
        before = _read(path)[1]
        if with_pictures:
            mapped(path)
    except DriverError as error:
        return str(error)
    if before and (other := differing(before, made)):
        return f"other {', '.join(other)}"
    return "" if before else "by an earlier version"


def _read(path: Path) -> tuple[Arrays, Identity]:
    try:
        with path.open("rb") as opened, np.load(opened) as file:
            found = dict(file)
        told = json.loads(str(found.pop(MADE_WITH, "{}")))
        return found, dict(told)
    except Exception as error:  # a damaged file can raise almost anything
        reason = str(error).split("\n", 1)[0] or "nothing"
        raise DriverError(f"{path}: expected arrays, got {reason}") from error
