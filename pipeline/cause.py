"""Describe an exception raised by user code in one line, with file and line number."""

import dis
import importlib
import sysconfig
from pathlib import Path
from traceback import walk_tb

from pipeline import signals
from pipeline.text import harmless, said_by

LONGEST = 300  # characters of a message
_ROOM = str(Path(__file__).parent)
_BETWEEN = (
    f"{_ROOM}/import_path.py",
    f"{_ROOM}/exits.py",
    importlib.__file__,
)  # they appear in every traceback
_INSTALLED = tuple(
    {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
)


def cause_of(error: BaseException) -> str:
    """Return `file:line: Type: message` for the innermost frame in the user's own code.

    Without such a frame, use the innermost one in an installed library; without any, return the
    message alone. For a syntax error, name the line that cannot be parsed.
    """
    kind = "it exits" if isinstance(error, SystemExit) else type(error).__name__
    text = error.msg if isinstance(error, SyntaxError) else said_by(error)
    said = f"{kind}: {harmless(str(text), LONGEST)}".rstrip(": ")
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno or 1}: {said}"
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in walk_tb(error.__traceback__)
        if not frame.f_code.co_filename.startswith("<") and frame.f_code.co_filename not in _BETWEEN
    ]
    outside = [(file, line) for file, line in frames if not file.startswith(_INSTALLED)]
    mine = [f for f in outside if not f[0].startswith(_ROOM)] or outside
    for file, line in reversed(mine or frames):
        return f"{file}:{line}: {said}"
    return said


def is_signal(error: BaseException) -> bool:
    """Whether a signal to this process raised the exception, not the code that was running.

    Python 3.11 wraps what a `__set_name__` raises, so also a signal while a class is made; a module
    in C whose import is interrupted raises an ImportError.
    """
    if isinstance(error, ImportError) and signals.raised_one():
        return True
    if isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__  # one step: an error may be its own cause
    traceback = error.__traceback__
    if traceback is None:
        return False
    while traceback.tb_next is not None:
        traceback = traceback.tb_next
    code = traceback.tb_frame.f_code
    if code.co_filename == signals.__file__:
        return True
    by_statement = code.co_code[traceback.tb_lasti] == dis.opmap["RAISE_VARARGS"]
    return isinstance(error, KeyboardInterrupt) and not by_statement
