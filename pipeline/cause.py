"""What went wrong in code that is not fovea's own, as one line with its file and line."""

import dis
import importlib
import sysconfig
from pathlib import Path
from traceback import walk_tb

from pipeline.wording import one_line

_ROOM = str(Path(__file__).parent)
_BETWEEN = (f"{_ROOM}/import_path.py", importlib.__file__)  # they stand in every traceback
_INSTALLED = tuple(
    {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
)


def cause_of(error: BaseException) -> str:
    """`file:line: Type: message`, of the innermost line that belongs to the user's own code.

    Without such a line it is the innermost one of an installed library, and without any the
    message alone. A syntax error names the line that cannot be read.
    """
    kind = "it exits" if isinstance(error, SystemExit) else type(error).__name__
    said = f"{kind}: {_message(error)}".rstrip(": ")
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


def is_raised(error: BaseException) -> bool:
    """Whether a statement raised it; a `KeyboardInterrupt` by Ctrl-C comes from no statement."""
    traceback = error.__traceback__
    if traceback is None:
        return False
    while traceback.tb_next is not None:
        traceback = traceback.tb_next
    code = traceback.tb_frame.f_code.co_code
    return code[traceback.tb_lasti] == dis.opmap["RAISE_VARARGS"]


def _message(error: BaseException) -> str:
    try:
        said = error.msg if isinstance(error, SyntaxError) else str(error)
    except Exception:  # its own __str__ is broken too
        return ""
    return one_line(str(said))
