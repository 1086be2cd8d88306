"""Files of arrays with a record of how they were made; written atomically."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.training.identity import Identity, differing
from pipeline.errors import DriverError
from pipeline.whole_file import whole_file

Arrays = dict[str, NDArray[Any]]
MADE_WITH = "made_with"


def write(path: Path, arrays: Mapping[str, NDArray[Any]], made: Identity) -> None:
    """Keep arrays, and what they were made with."""
    told = {MADE_WITH: np.array(json.dumps(dict(made)))}
    with whole_file(path) as file:
        np.savez(file, allow_pickle=False, **arrays, **told)


def read(path: Path) -> Arrays:
    """All arrays of a file; raises `DriverError` for one that is damaged or is none of these."""
    return _read(path)[0]


def outdated(paths: Iterable[Path], made: Identity, say: Callable[[str], None]) -> list[Path]:
    """Return the files to make again: missing, damaged, or made otherwise; report why."""
    found, reasons = [], Counter[str]()
    for path in paths:
        if path.exists():
            reason = _fault(path, made)
            if not reason:
                continue
            reasons[f"{path.parent}: made anew: {reason}"] += 1
        found.append(path)
    for reason, count in reasons.items():
        say(f"{reason} ({count} file{'s' * (count > 1)})")
    return found


def _fault(path: Path, made: Identity) -> str:
    try:
        before = _read(path)[1]
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
