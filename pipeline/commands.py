"""Commands of an operator (`fovea tell`): a name and arguments in, plain values out.

An operator lists them in `commands`. Each is a method `do_<command>` with typed, named arguments,
which may have defaults; it returns a mapping of plain values or None. It is called between two
calls of handlers, by the same thread.
"""

import dataclasses
import inspect
import json
import typing
from collections.abc import Mapping
from typing import Any

from pipeline import settings as checked
from pipeline.contract import Operator
from pipeline.errors import SettingsError
from pipeline.text import said_by
from pipeline.wording import shown_key


def commands_of(operator: type[Operator[Any, Any]]) -> dict[str, type[Any]]:
    """Return a dataclass of arguments per command; raises `SettingsError` for a bad declaration."""
    return {name: _arguments(operator, name) for name in operator.commands}


def carry_out(
    node: str, operator: Operator[Any, Any], command: str, arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """Call a command of an operator and return its result as plain values.

    Raises `SettingsError` for an unknown command or wrong arguments, without calling anything, and
    for a result that is neither None nor a mapping of plain values.
    """
    given = _checked(type(operator), command, arguments, node)
    returned = getattr(operator, f"do_{command}")(**given)
    return _plain(f"{node}.{command}", returned)


def _plain(where: str, returned: object) -> dict[str, Any]:
    """Return a command's result as JSON holds it, empty for None; raises `SettingsError`."""
    if returned is None:
        return {}
    expected = f"{where}: expected a mapping of plain values"
    if not isinstance(returned, Mapping):
        raise SettingsError(f"{expected}, got {type(returned).__name__}")
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(returned)))
    except (TypeError, ValueError, RecursionError) as error:
        raise SettingsError(f"{expected}: {said_by(error)}") from error
    return plain


def _checked(
    cls: type[Operator[Any, Any]], command: str, arguments: Mapping[str, Any], node: str
) -> dict[str, Any]:
    """Return the arguments converted to the types of the method; raises `SettingsError`."""
    known = commands_of(cls)
    if command not in known:
        hint = checked.suggest(command, known)
        raise SettingsError(f"{node}: no command {shown_key(command)}{hint}")
    built = checked.build(known[command], arguments, f"{node}.{command}", kind="argument")
    return {f.name: getattr(built, f.name) for f in dataclasses.fields(built)}


def _arguments(operator: type[Operator[Any, Any]], name: str) -> type[Any]:
    where = f"{operator.__module__}:{operator.__qualname__}.commands"
    method = getattr(operator, f"do_{name}", None)
    if not callable(method):
        raise SettingsError(f"{where}: expected a method do_{name}, got none")
    hints = typing.get_type_hints(method)
    fields: list[Any] = []
    for parameter in list(inspect.signature(method).parameters.values())[1:]:
        if parameter.name not in hints:
            raise SettingsError(f"{where}: do_{name}({parameter.name}): expected a type, got none")
        field: tuple[Any, ...] = (parameter.name, hints[parameter.name])
        if parameter.default is not parameter.empty:
            field = (*field, dataclasses.field(default=parameter.default))
        fields.append(field)
    return dataclasses.make_dataclass(name, fields, frozen=True, kw_only=True)
