"""Import paths as graph files write them: `module:Class` -> the class.

Importing a module runs user code: whatever it raises becomes one sentence with the file and line of
the cause, and its output goes to standard error.
"""

import contextlib
import importlib
import re
import sys
from typing import Any

from pipeline.cause import cause_of, is_signal
from pipeline.errors import FoveaError
from pipeline.extras import remedy
from pipeline.user_modules import advice, current_folder
from pipeline.wording import shown

PATTERN = r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*"
_PATH = re.compile(PATTERN)


def is_import_path(value: object) -> bool:
    """Whether a value has the form of an import path.

    >>> is_import_path("drivers.datasets:VideoFile"), is_import_path("http://x"), is_import_path(5)
    (True, False, False)
    """
    return isinstance(value, str) and _PATH.fullmatch(value) is not None


def check_import_path(value: object, where: str, error: type[FoveaError]) -> str:
    """Return the value if it is an import path; else raise `error` beginning with `where`."""
    if isinstance(value, str) and is_import_path(value):
        return value
    place = f"{where}: " if where else ""
    raise error(f"{place}expected an import path module:Class, got {shown(value)}")


def imported(path: str, error: type[FoveaError], where: str = "") -> Any:
    """Import and return what `module:Name` names; raises `error` beginning with `where`.

    >>> from pipeline.errors import SettingsError
    >>> imported("math:pi", SettingsError)
    3.141592653589793
    >>> imported("math", SettingsError, "sensor")
    Traceback (most recent call last):
    pipeline.errors.SettingsError: sensor: expected an import path module:Class, got 'math'
    """
    module, _, name = check_import_path(path, where, error).partition(":")
    place = f"{where}: " if where else ""
    try:
        known = module in sys.modules  # no code of it will run
        with contextlib.nullcontext() if known else contextlib.redirect_stdout(sys.stderr):
            return getattr(importlib.import_module(module), name)
    except BaseException as cause:
        if is_signal(cause):
            raise
        why = _missing(cause, module) if isinstance(cause, ModuleNotFoundError) else ""
        told = f"{why or cause_of(cause)}{advice(module)}"
        raise error(f"{place}{path} cannot be imported: {told}") from cause


def _missing(error: ModuleNotFoundError, module: str) -> str:
    """Say what would help, or where a module was looked for; nothing if it is another's."""
    if found := remedy(error):
        return found
    missing = error.name == module.partition(".")[0]
    return f"{cause_of(error)}, neither in {current_folder()} nor installed" if missing else ""
