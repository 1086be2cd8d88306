"""Plain values from outside into settings dataclasses, strictly: mapping -> frozen dataclass.

Types are checked by pydantic (a list may stand for a tuple and an int for a float, nothing else is
converted); unknown names get a suggestion; ranges are the dataclass's own affair.
"""

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from pipeline.errors import SettingsError
from pipeline.once import once

T = TypeVar("T")


def build(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """An instance of the dataclass `cls`; raises `SettingsError` beginning with `where`."""
    known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
    for name in values:
        if name not in known:
            raise SettingsError(f"{where}.{name}: no such setting{suggest(name, known)}")
    try:
        document = json.dumps(dict(values), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"{where}: {error}") from error
    try:
        return _adapter(cls).validate_json(document, strict=True)  # type: ignore[no-any-return]
    except ValidationError as error:
        raise SettingsError(_sentence(error, where)) from error


def plain(settings: Any) -> dict[str, Any]:
    """Every setting's value in the words of a graph file.

    >>> from pipeline.graph.plan import Restart
    >>> plain(Restart(most=2))
    {'policy': 'on-failure', 'backoff_s': 0.05, 'window_s': 60.0, 'most': 2}
    """
    values: dict[str, Any] = _adapter(type(settings)).dump_python(settings, mode="json")
    return values


def json_schema(cls: type[Any]) -> dict[str, Any]:
    """The JSON Schema of a settings dataclass."""
    return _adapter(cls).json_schema()


def suggest(name: str, known: Iterable[str]) -> str:
    """`, did you mean 'x'?` or, with nothing near, what there is.

    >>> suggest("capure", ["capture", "policy"])
    ", did you mean 'capture'?"
    """
    options = list(known)
    near = difflib.get_close_matches(name, options, 1, 0.6)
    if near:
        return f", did you mean '{near[0]}'?"
    return f"; there is {', '.join(options)}" if options else "; there is none"


@once
def _adapter(cls: type[Any]) -> TypeAdapter[Any]:
    cls.__pydantic_config__ = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
    return TypeAdapter(cls)


def _sentence(error: ValidationError, where: str) -> str:
    first = error.errors(include_url=False)[0]
    place = ".".join([where, *(str(part) for part in first["loc"])])
    if first["type"] == "missing":
        return f"{place}: required, got nothing"
    if isinstance(cause := first.get("ctx", {}).get("error"), Exception):
        return f"{where}.{cause}"
    return f"{place}: {first['msg'].lower()}, got {first['input']!r}"
