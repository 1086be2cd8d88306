"""Classes of a detector: their names, reported names and confidence thresholds."""

import ast
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline import SettingsError, WeightsError


def class_names(metadata: Mapping[str, str], count: int) -> list[str]:
    """Names in the network's own order; numbers where its metadata has none.

    >>> class_names({"names": "{0: 'person', 1: 'ball'}"}, 2)
    ['person', 'ball']
    """
    table = {int(str(key)): str(name) for key, name in _table(metadata, "names").items()}
    return [table.get(index, str(index)) for index in range(count)]


def named_classes(metadata: Mapping[str, str]) -> list[str]:
    """The classes that the metadata names, in the network's own order; none where it names none.

    >>> named_classes({"names": "['person', 'ball']"}), named_classes({})
    (['person', 'ball'], [])
    """
    numbers = [int(str(key)) for key in _table(metadata, "names")]
    return class_names(metadata, max(numbers) + 1) if numbers else []


def report_as(
    own: list[str], wanted: Mapping[str, str]
) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    """Return reported names, and per class of the network its index among them (-1: left out).

    Several classes may be reported under one name; an empty table reports all as they are.

    >>> report_as(["person", "car", "sports ball"], {"0": "player", "sports ball": "ball"})
    (('player', 'ball'), array([ 0, -1,  1]))
    """
    if not wanted:
        return tuple(own), np.arange(len(own), dtype=np.intp)
    names = tuple(dict.fromkeys(wanted.values()))
    index = np.full(len(own), -1, np.intp)
    for key, name in wanted.items():
        place = int(key) if key.isdecimal() else own.index(key) if key in own else -1
        if not 0 <= place < len(own):
            raise SettingsError(f"names.{key}: expected a class of the network, one of {len(own)}")
        index[place] = names.index(name)
    return names, index


def own_confidence(metadata: Mapping[str, str]) -> dict[str, float]:
    """Operating points chosen when the network was trained, by its class names; may be empty."""
    return {str(k): float(str(v)) for k, v in _table(metadata, "confidence").items()}


def thresholds(
    names: Sequence[str], own: Mapping[str, float], wanted: Mapping[str, float], default: float
) -> NDArray[np.float32]:
    """Return the threshold of each reported name, followed by 2, which no score reaches.

    >>> thresholds(["player", "ball"], {"ball": 0.5}, {}, 0.25).tolist()
    [0.25, 0.5, 2.0]
    """
    unknown = sorted(set(wanted) - set(names))
    if unknown:
        raise SettingsError(
            f"class_confidence: expected names among {', '.join(names)}, got {', '.join(unknown)}"
        )
    limits = [wanted.get(name, own.get(name, default)) for name in names]
    return np.array([*limits, 2.0], np.float32)


def _table(metadata: Mapping[str, str], key: str) -> dict[object, object]:
    try:
        found = ast.literal_eval(metadata.get(key, "{}"))
        return dict(found) if isinstance(found, dict) else dict(enumerate(found))
    except (ValueError, SyntaxError, TypeError) as error:
        raise WeightsError(
            f"saliency: metadata {key}: expected a table, got {metadata[key]!r}"
        ) from error
