"""Classes of a detector: their names, reported names and confidence thresholds."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline import SettingsError
from pipeline.wording import shown

MOST_CLASSES = 20_000
LONGEST_NAME = 100  # characters
MOST_LISTED = 100  # names in an error


def checked_names(names: Iterable[object]) -> tuple[str, ...]:
    """Return class names in the network's own order; raises `ValueError` for what is no name.

    >>> checked_names(["person", "sports ball", 3])
    ('person', 'sports ball', '3')
    """
    found = []
    for number, name in enumerate(names):
        text = str(name) if type(name) is int else name
        if not isinstance(text, str) or not text.strip() or not text.isprintable():
            raise ValueError(f"expected a name of class {number}, got {shown(name)}")
        if len(text) > LONGEST_NAME:
            got = f"{len(text)}: {shown(text, 20)}"
            raise ValueError(f"expected names of up to {LONGEST_NAME} characters, got {got}")
        found.append(text)
    if len(found) > MOST_CLASSES:
        raise ValueError(f"expected up to {MOST_CLASSES} names, got {len(found)}")
    return tuple(found)


def report_as(
    own: Sequence[str], wanted: Mapping[str, str]
) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    """Return reported names, and per class of the network its index among them (-1: left out).

    Several classes may be reported under one name; an empty table reports all as they are.

    >>> report_as(["person", "car", "sports ball"], {"0": "player", "sports ball": "ball"})
    (('player', 'ball'), array([ 0, -1,  1]))
    """
    if not wanted:
        names = tuple(dict.fromkeys(own))
        place = {name: index for index, name in enumerate(names)}
        return names, np.array([place[name] for name in own], np.intp)
    names = tuple(dict.fromkeys(wanted.values()))
    index = np.full(len(own), -1, np.intp)
    for key, name in wanted.items():
        rows = [row for row, named in enumerate(own) if named == key]
        if not rows and key.isdecimal() and len(key) < 6 and int(key) < len(own):
            rows = [int(key)]
        if not rows:
            raise SettingsError(f"names.{key}: expected a class of the network, {listed(own)}")
        index[rows] = names.index(name)
    return names, index


def thresholds(
    own: Sequence[str],
    known: Mapping[str, float],
    reported: Sequence[str],
    wanted: Mapping[str, float],
    default: float,
) -> NDArray[np.float32]:
    """Return the threshold of each class of the network, `own`.

    `known` is by the network's names, `wanted` by those under which the classes are reported, ""
    where one is left out: its threshold is 2, which no score reaches.

    >>> thresholds(["man", "ball", "car"], {"ball": 0.5}, ["player", "ball", ""], {}, 0.25).tolist()
    [0.25, 0.5, 2.0]
    """
    unknown = sorted(set(wanted) - set(reported))
    if unknown:
        names = [name for name in dict.fromkeys(reported) if name]
        raise SettingsError(
            f"class_confidence: expected names among {listed(names)}, got {', '.join(unknown)}"
        )
    limits = [
        wanted.get(name, known.get(mine, default)) if name else 2.0
        for mine, name in zip(own, reported, strict=True)
    ]
    return np.array(limits, np.float32)


def listed(names: Sequence[str], most: int = MOST_LISTED) -> str:
    """Return the names for a sentence, the first of them where there are many.

    >>> listed(["player", "ball"]), listed(["a", "b", "c"], 2)
    ('player, ball', 'a, b … (1 more)')
    """
    more = f" … ({len(names) - most} more)" if len(names) > most else ""
    return ", ".join(names[:most]) + more
