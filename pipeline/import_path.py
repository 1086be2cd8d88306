"""Import paths as graph files write them: `module:Class` -> the class."""

import importlib
from typing import Any

from pipeline.errors import FoveaError


def imported(path: str, error: type[FoveaError], where: str = "") -> Any:
    """What `module:Name` names; raises `error`, its sentence beginning with `where`.

    >>> from pipeline.errors import SettingsError
    >>> imported("math:pi", SettingsError)
    3.141592653589793
    >>> imported("math", SettingsError, "sensor")
    Traceback (most recent call last):
    pipeline.errors.SettingsError: sensor: expected an import path module:Class, got 'math'
    """
    place = f"{where}: " if where else ""
    module, _, name = path.partition(":")
    if not module or not name or module.startswith("."):
        raise error(f"{place}expected an import path module:Class, got {path!r}")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as cause:
        raise error(f"{place}{path} cannot be imported: {cause}") from cause
