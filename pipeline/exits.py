"""Turn `os._exit`, called by an operator in a command's own process, into an exception.

Node processes are not affected: there the call ends the process and the supervisor reports it.
"""

import contextlib
import faulthandler
import os
import sys
from pathlib import Path
from typing import NoReturn

_ROOM = os.path.join(Path(__file__).parent, "")


class Exits(SystemExit):
    """User code called `os._exit`."""


def refuse() -> None:
    """Make `os._exit` raise `Exits` in this process, except when fovea's own code calls it.

    Forked processes may still call it. For a crash of an extension module, which cannot be
    caught, the traceback of the calling Python code is printed.
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
