"""Build settings dataclasses strictly from plain values: mapping -> frozen dataclass.

pydantic checks types (a list is accepted as a tuple, an int as a float and a whole float as an int;
nothing else is converted). Unknown names get a suggestion; the dataclass checks ranges. Whatever a
dataclass raises for its values becomes one sentence.
"""

import difflib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from pipeline.cause import cause_of, is_signal
from pipeline.class_cache import cached_by_class
from pipeline.errors import FoveaError, SettingsError
from pipeline.text import WHOLE_HIGH, WHOLE_LOW, harmless
from pipeline.wording import shown, shown_key

T = TypeVar("T")
DEEPEST = 32  # nested levels of a value


class WrongSetting(SettingsError):
    """A wrong setting; `path` holds the keys that lead to it, outermost first."""

    def __init__(self, sentence: str, path: tuple[str, ...] = ()) -> None:
        super().__init__(sentence)
        self.path = path


def build(cls: type[T], values: Mapping[str, Any], where: str, *, kind: str = "setting") -> T:
    """Return an instance of the dataclass `cls`; raises `SettingsError` beginning with `where`.

    `kind` is what an unknown name is called. A class attribute `FORMER` of `cls` maps each removed
    setting to a sentence for its error.
    """
    known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
    former: Mapping[str, str] = getattr(cls, "FORMER", {})
    for name in values:
        if name not in known:
            if name in former:
                raise WrongSetting(f"{where}.{name}: {former[name]}", (name,))
            hint = suggest(str(name), known)
            raise WrongSetting(f"{where}.{shown_key(name)}: no such {kind}{hint}", (str(name),))
        check_plain(values[name], f"{where}.{name}", (name,))
    try:
        built: T = _strict_adapter(cls).validate_json(json.dumps(_whole(values)), strict=True)
    except ValidationError as error:
        raise _wrong(error, where) from error
    except FoveaError:
        raise
    except Exception as error:  # the dataclass's own code failed on its values
        if is_signal(error):
            raise
        raise WrongSetting(f"{where}: {cls.__name__} broke: {cause_of(error)}") from error
    return built


def fit(kind: Any, value: Any, where: str) -> Any:
    """Return a plain value as a type has it; raises `SettingsError` beginning with `where`.

    >>> fit(tuple[int, int], [640, 480], "size_px")
    (640, 480)
    """
    check_plain(value, where)
    try:
        return TypeAdapter(kind).validate_json(json.dumps(_whole(value)), strict=True)
    except ValidationError as error:
        raise _wrong(error, where) from error


def check_plain(value: Any, where: str, path: tuple[str, ...] = ()) -> None:
    """Raise `SettingsError` unless JSON and messages can represent a value.

    >>> check_plain({"rate_hz": [float("inf")]}, "capture.options")
    Traceback (most recent call last):
    pipeline.settings.WrongSetting: capture.options.rate_hz: expected a finite number, got inf
    """
    if len(path) > DEEPEST:
        raise WrongSetting(f"{where[:60]}…: expected up to {DEEPEST} levels, got more", path)
    if isinstance(value, Mapping):
        for key, item in value.items():
            if not isinstance(key, str):
                raise WrongSetting(f"{where}: expected a text as key, got {shown(key)}", path)
            _check_text(key, where, path)
            check_plain(item, f"{where}.{shown_key(key)}", (*path, key))
    elif isinstance(value, (list, tuple)):
        for item in value:
            check_plain(item, where, (*path, ""))
    elif isinstance(value, str):
        _check_text(value, where, path)
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise WrongSetting(f"{where}: expected a finite number, got {value}", path)
    elif isinstance(value, int):
        if not WHOLE_LOW <= value <= WHOLE_HIGH:
            what = "a whole number within 64 bits"
            raise WrongSetting(f"{where}: expected {what}, got {shown(value, 40)}", path)
    elif value is not None:
        raise WrongSetting(f"{where}: expected a plain value, got a {type(value).__name__}", path)


def _within_64_bits(schema: Any) -> Any:
    """Return a schema whose integers are limited to the range that messages can carry."""
    if isinstance(schema, list):
        return [_within_64_bits(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _within_64_bits(item) for key, item in schema.items()}
    limits = {"minimum": WHOLE_LOW, "maximum": WHOLE_HIGH}
    return {**limits, **found} if found.get("type") == "integer" else found


def _whole(value: Any) -> Any:
    """Convert whole floats to integers, as in JSON Schema: 3.0 is an integer, and 3 a float."""
    if isinstance(value, Mapping):
        return {key: _whole(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_whole(item) for item in value]
    if isinstance(value, float) and value.is_integer() and WHOLE_LOW <= value < WHOLE_HIGH:
        return int(value)
    return value


def check_type(cls: type[Any]) -> None:
    """Raise the error of a settings dataclass whose declaration cannot be evaluated."""
    fields(cls)
    _strict_adapter(cls)


def plain(settings: Any) -> dict[str, Any]:
    """Return every setting's value as a graph file would write it.

    >>> from pipeline.graph.plan import Restart
    >>> plain(Restart(most=2))
    {'policy': 'on-failure', 'backoff_s': 0.05, 'window_s': 60.0, 'most': 2}
    """
    values: dict[str, Any] = _strict_adapter(type(settings)).dump_python(settings, mode="json")
    return values


def json_schema(cls: type[Any]) -> dict[str, Any]:
    """Return the JSON Schema of a settings dataclass."""
    found: dict[str, Any] = _within_64_bits(_strict_adapter(cls).json_schema())
    return found


def suggest(name: str, known: Iterable[str]) -> str:
    """Return `, did you mean 'x'?` or, without a close match, a list of the known names.

    >>> suggest("capure", ["capture", "policy"])
    ", did you mean 'capture'?"
    """
    options = list(known)
    near = difflib.get_close_matches(name[:100], options, 1, 0.6)
    if near:
        return f", did you mean '{near[0]}'?"
    return f"; there is {', '.join(options)}" if options else "; there is none"


@cached_by_class
def _strict_adapter(cls: type[Any]) -> TypeAdapter[Any]:
    cls.__pydantic_config__ = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
    return TypeAdapter(cls)


def _check_text(text: str, where: str, path: tuple[str, ...]) -> None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        what = f"expected a text of whole characters, got {shown(text)}"
        raise WrongSetting(f"{where}: {what}", path) from error


def _wrong(error: ValidationError, where: str) -> WrongSetting:
    first = error.errors(include_url=False)[0]
    path = tuple(str(part) for part in first["loc"])
    place = ".".join([where, *(shown_key(part) for part in path)])
    if first["type"] == "missing":
        return WrongSetting(f"{place}: required, got nothing", path)
    if isinstance(cause := first.get("ctx", {}).get("error"), Exception):
        if isinstance(cause, FoveaError):  # its text begins with the setting's name
            said = str(cause)
            return WrongSetting(f"{where}.{said}", tuple(said.partition(":")[0].split(".")))
        return WrongSetting(f"{place}: {cause_of(cause)}", path)
    said = harmless(first["msg"].lower(), 200)
    return WrongSetting(f"{place}: {said}, got {shown(first['input'])}", path)
