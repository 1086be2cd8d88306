"""`os._exit` called by an operator's code in a command's own process: an exception, no silent end.

Node processes are not concerned: there it ends the process, and the supervisor tells of it.
"""

import contextlib
import faulthandler
import os
import sys
from pathlib import Path
from typing import NoReturn

_ROOM = os.path.join(Path(__file__).parent, "")


class Exits(SystemExit):
    """Code that is not fovea's own called `os._exit`."""


def refuse() -> None:
    """From now on `os._exit` raises `Exits` in this process, but for fovea's own code.

    Processes that are forked from this one may end so. A crash of an extension module, which
    nothing can catch, is told with the line that called it.
    """
    pid, leave = os.getpid(), os._exit

    def leave_or_raise(status: int) -> NoReturn:
        caller = sys._getframe(1).f_code.co_filename
        if os.getpid() != pid or caller.startswith(_ROOM):
            leave(status)
        raise Exits(f"os._exit({status!r})")

    os._exit = leave_or_raise
    with contextlib.suppress(OSError, RuntimeError, ValueError):  # no standard error
        faulthandler.enable()
