"""Node process: receives an assignment, then runs the operators of one group until `Stop`.

It passes the supervisor's instructions to its group and sends it events
(`pipeline.protocol.supervision`); all output of operators goes to the log.
"""

import contextlib
import faulthandler
import importlib
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import NoReturn

from pipeline.node.control import Control
from pipeline.node.group import FAREWELL_S, Group, failure
from pipeline.node.inspection import inspect
from pipeline.node.logfile import LogFile, log_to
from pipeline.node.wiring import ASIDE
from pipeline.process_tree import adopt_orphans, descendants, end, session_of, zombies
from pipeline.protocol.supervision import (
    Assignment,
    Failed,
    Finish,
    Go,
    Idle,
    Inspect,
    Instruction,
    Leaving,
    NodeInstruction,
    Stop,
)
from pipeline.text import error_text
from pipeline.user_modules import look_in

ASIDE_NICENESS = 5  # of processes that are not on the path of sensor commands
AHEAD_NICENESS = 19  # of imports in advance


def main() -> None:
    """Read the first instruction, obey it, announce the end, and exit with 0 or 1."""
    adopt_orphans()  # orphans of its operators end with it
    look_in()
    control = Control.from_standard_input()
    try:
        failed = _work(control)
    except BaseException as error:  # an error before any operator runs
        traceback.print_exc()
        control.say(Failed(error_text(error), False))
        failed = True
    control.say(Leaving())
    _leave(1 if failed else 0, alone=control.alone)


def _work(control: Control) -> bool:
    """Run the assignment, or inspect a plan; return whether it failed."""
    loader = threading.Thread(target=_import_ahead, args=(sys.argv[2:],))
    loader.start()
    loader.join()
    _level()
    control.say(Idle())
    instructions = control.instructions()
    job = next(instructions, None)
    if isinstance(job, Inspect):
        return _inspect(job, control, instructions)
    if not isinstance(job, Assignment):
        _leave(0, alone=True)  # a spare that was not needed
    first = max(job.epochs.values()) == 1 and not job.trial
    file = log_to(Path(job.run_folder) / f"{job.process}.log", fresh=first)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    faulthandler.enable(file)  # prints the stack when an extension module crashes
    faulthandler.register(signal.SIGUSR1, file)  # requested before a stalled node is killed
    sys.setswitchinterval(0.001)  # delivering threads must not wait 5 ms for the GIL
    path = job.plan.command_path()
    if path and not any(n.name in path for n in job.nodes):
        os.nice(ASIDE_NICENESS)

    def look() -> None:
        with contextlib.suppress(OSError):
            file.look()
        reap_strangers()

    group = Group(job, control.say, look)
    threading.excepthook = partial(_on_thread, group)
    obey = partial(_obey, group, control, instructions, file)
    threading.Thread(target=obey, daemon=True).start()
    group.run()
    return group.failed


def _inspect(job: Inspect, control: Control, instructions: Iterator[Instruction]) -> bool:
    """Import the operators of a plan and report whether they fit; return whether that failed."""
    file = log_to(Path(job.log), fresh=True)
    faulthandler.enable(file)
    faulthandler.dump_traceback_later(job.timeout_s / 2, file=file)
    leaver = threading.Thread(target=_leave_without, args=(control, instructions), daemon=True)
    leaver.start()
    try:
        control.say(inspect(job))
    except BaseException as error:  # a module may raise SystemExit, a library panic
        control.say(failure(error))
        return True
    return False


def _leave_without(control: Control, instructions: Iterator[Instruction]) -> None:
    """Leave when the process that asked for an inspection has ended."""
    for _ in instructions:
        pass
    _leave(2, alone=control.alone)


def _on_thread(group: Group, broken: threading.ExceptHookArgs) -> None:
    """Handle an exception in a thread of an operator as one of the operator."""
    if broken.exc_value is not None and not isinstance(broken.exc_value, SystemExit):
        group.report(broken.exc_value)
        group.stop()


def _leave(status: int, *, alone: bool) -> NoReturn:
    """End its descendants and itself; without a supervisor also its group."""
    end(descendants(os.getpid()))
    if alone and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(status)  # Zenoh's threads would keep the interpreter waiting


def _import_ahead(modules: Iterable[str]) -> None:
    """Import modules in advance, ignoring errors, which recur when an operator is loaded.

    On Linux niceness is per thread, so that the running graph keeps its cores.
    """
    wanted = set(modules)
    if ASIDE in wanted:
        os.nice(AHEAD_NICENESS)
    for module in sorted(wanted - {ASIDE}):
        with contextlib.suppress(Exception):
            importlib.import_module(module)


def reap_strangers() -> None:
    """Reap ended children that were certainly adopted.

    Own children are in this session or lead one; they are kept until the end, because an operator
    may wait for their status.
    """
    for pid in zombies(os.getpid()):
        if session_of(pid) not in (os.getsid(0), pid):
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)


def _level() -> None:
    """Reset the niceness of threads started during imports, where permitted."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, int(thread), os.getpriority(os.PRIO_PROCESS, 0))


def _obey(
    group: Group, control: Control, instructions: Iterator[Instruction], file: LogFile
) -> None:
    """Pass instructions on until `Stop`; leave if the group takes too long to close after it."""
    for told in instructions:
        if isinstance(told, Go):
            group.go.set()
        elif isinstance(told, Finish):
            group.finish()
        elif isinstance(told, Stop):
            break
        elif isinstance(told, NodeInstruction):
            group.do(told)
    group.stop()
    threading.Event().wait(FAREWELL_S)
    faulthandler.dump_traceback(file)  # shows what does not return
    _leave(2, alone=control.alone)


if __name__ == "__main__":
    main()
