"""Node process: receives an assignment, then runs the operators of one group until `Stop`.

It passes the supervisor's instructions to its operators' threads and sends it events
(`pipeline.protocol.supervision`); all output of operators goes to the log.
"""

import contextlib
import faulthandler
import gc
import importlib
import json
import logging
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from pipeline import settings as checked
from pipeline.bus.ledger import Ledger
from pipeline.bus.session import Session
from pipeline.contract import Operator, Source, settings_of
from pipeline.errors import FoveaError
from pipeline.graph.plan import Node, load_operator
from pipeline.node.control import Control
from pipeline.node.handover import Say
from pipeline.node.inspection import imported, inspect
from pipeline.node.logfile import log_to
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.port_contract import check_fit
from pipeline.node.source import SourceRunner
from pipeline.node.wiring import ASIDE, Wiring
from pipeline.node.wiring import settings_of as node_settings
from pipeline.private_folder import PrivateFolder
from pipeline.process_tree import adopt_orphans, descendants, end, session_of, zombies
from pipeline.protocol.codec import encode
from pipeline.protocol.supervision import (
    MOST_EVENT_BYTES,
    Assignment,
    Confirm,
    Cut,
    Failed,
    Finish,
    Finished,
    Fits,
    Go,
    Headline,
    Idle,
    Inspect,
    Instruction,
    Leaving,
    NodeInstruction,
    Ready,
    Replan,
    Resume,
    Stop,
    Summary,
    Uncut,
)
from pipeline.text import error_text, harmless, plain, said_by

ASIDE_NICENESS = 5  # of processes that are not on the path of sensor commands
AHEAD_NICENESS = 19  # of imports in advance
HEADLINE_S = 1.0  # interval of headlines
FAREWELL_S = 3.0  # after this time the process ends, whatever operators do
log = logging.getLogger(__name__)


class Process:
    """The nodes of one group in this process."""

    def __init__(self, job: Assignment, say: Say, look: Callable[[], None] = lambda: None) -> None:
        """`say` sends an event to the supervisor; `look` is called about once a second."""
        self._job, self.say, self._look = job, say, look
        self._nodes = list(job.nodes)
        self._ledger = Ledger.open(PrivateFolder(Path(job.memory_folder)))
        self._runners: list[OperatorRunner] = []
        self._operators: list[Operator[Any, Any]] = []
        self._session: Session | None = None
        self._border: Session | None = None
        self._headlines: dict[str, str] = {}
        self._wiring: Wiring | None = None
        self.go = threading.Event()
        self.failed = False

    def run(self) -> None:
        """Open everything, run until stopped, close everything."""
        began_s = time.monotonic()
        try:
            self._check()
            if self._job.trial:
                return self.say(Fits(imported(self._nodes)))
            for node in self._nodes:
                if not self._job.standby:
                    account = self._ledger.nodes[node.index]
                    account.epoch = self._job.epochs[node.name]
                    account.enter("starting")
                self._operators.append(self._make(node))
                self._operators[-1].open()
            loaded_s = time.monotonic()
            self._session = Session(Path(self._job.run_folder), self._job.instance)
            if self._job.network is not None:
                self._border = Session.across(self._job.network)
            self._wiring = Wiring(self._job, self._session, self._ledger, self.say, self._border)
            self._runners = [
                self._wiring.runner(n, o) for n, o in zip(self._nodes, self._operators, strict=True)
            ]
            gc.collect()
            gc.freeze()  # loaded objects stay: exclude them from garbage collection
            self.say(Ready(loaded_s - began_s, imported(self._nodes)))
            self._run_all()
        except BaseException as error:  # an operator may raise SystemExit, a library panic
            self.report(error)
        finally:
            self._close()

    def _check(self) -> None:
        """Check contracts of an operator that is new in a running graph, before opening."""
        for node in self._nodes:
            contract = self._job.contracts.get(node.name)
            if contract:
                check_fit(self._job.plan, node, contract)
            if contract or self._job.trial:
                self._make(node)

    def stop(self) -> None:
        """Make every runner return."""
        self.go.set()
        for runner in self._runners:
            runner.stop()

    def finish(self) -> None:
        """Make sources stop producing."""
        for runner in self._runners:
            if isinstance(runner, SourceRunner):
                runner.end()

    def do(self, told: NodeInstruction) -> None:
        """Execute an instruction to one node, between two calls of its handlers."""
        runner = next((r for r in self._runners if r.name == told.node), None)
        wiring = self._wiring
        handover = wiring.handovers.get(told.node) if wiring else None
        if runner is None or wiring is None:
            log.error("%s: no node %s here", self._job.process, harmless(told.node, 100))
        elif isinstance(told, Replan):
            runner.between(partial(wiring.replan, told.node, told.plan), must=True)
        elif handover is None:
            log.error("%s: %s: cannot %s", self._job.process, told.node, type(told).__name__)
        elif isinstance(told, Cut):
            runner.between(partial(handover.request, told), must=True)
        elif isinstance(told, Uncut):
            runner.between(partial(handover.request, None), must=True)
        elif isinstance(told, Resume):
            runner.between(partial(handover.resume, told.epoch), must=True)
        elif isinstance(told, Confirm):
            runner.between(handover.confirm, must=True)

    def _make(self, node: Node) -> Operator[Any, Any]:
        cls = load_operator(node.operator)
        operator = cls(checked.build(settings_of(cls), node_settings(self._job, node), node.name))
        if isinstance(operator, Source):
            operator.realtime = self._job.plan.clock == "realtime"
        return operator

    def _run_all(self) -> None:
        threads = [
            threading.Thread(target=self._guard, args=(runner,), name=runner.name)
            for runner in self._runners
        ]
        for thread in threads:
            thread.start()
        try:
            self._note_providers()  # not only after a second: a run may be shorter
            for thread in threads:
                while thread.is_alive():
                    thread.join(HEADLINE_S)
                    self._look()
                    self._note_providers()
                    self._tell_headlines()
                    for runner in self._runners:
                        if isinstance(runner, SourceRunner):
                            runner.note_absence()
        finally:
            self.stop()
            for thread in threads:
                thread.join(FAREWELL_S)

    def _note_providers(self) -> None:
        for runner in self._runners:  # again and again: a successor gets the account later
            runner.account.provider = str(runner.operator.runs_on())

    def _tell_headlines(self) -> None:
        for node, operator in zip(self._nodes, self._operators, strict=True):
            words = str(operator.headline())
            if words != self._headlines.get(node.name, ""):
                self._headlines[node.name] = words
                self.say(Headline(node.name, words))

    def _guard(self, runner: OperatorRunner) -> None:
        try:
            if isinstance(runner, SourceRunner):
                runner.on_finished = lambda: self.say(Finished(runner.name))
                while not self.go.is_set():
                    runner.attend()
            runner.run()
        except BaseException as error:  # an operator may raise SystemExit, a library panic
            self.report(error)
            self.stop()

    def report(self, error: BaseException) -> None:
        """Report the first error, which is the cause, to the supervisor.

        The log contains every error with its traceback.
        """
        failed = _failed(error)
        if not self.failed:
            self.say(failed)
        self.failed = True

    def _tell_summary(self, node: Node, operator: Operator[Any, Any]) -> None:
        self.say(_summary(node.name, operator.summary()))

    def _close(self) -> None:
        for node, operator in zip(self._nodes, self._operators, strict=False):
            for act in (partial(self._tell_summary, node, operator), operator.close):
                try:
                    act()
                except BaseException as error:
                    self.report(error)
        if not self._job.standby and not self._runners:
            for node in self._nodes:
                self._ledger.nodes[node.index].enter("stopped")
        for runner in self._runners:
            runner.account.enter("stopped")
            if isinstance(runner, SourceRunner):
                self.say(_summary(runner.name, runner.figures()))
        if self._wiring is not None:
            self._wiring.close()
        for session in (self._session, self._border):
            if session is not None:
                session.close()


def main() -> None:
    """Read the first instruction, obey it, announce the end, and exit with 0 or 1."""
    adopt_orphans()  # orphans of its operators end with it
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

    process = Process(job, control.say, look)
    threading.excepthook = partial(_on_thread, process)
    threading.Thread(target=_obey, args=(process, control, instructions), daemon=True).start()
    process.run()
    return process.failed


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
        control.say(_failed(error))
        return True
    return False


def _leave_without(control: Control, instructions: Iterator[Instruction]) -> None:
    """Leave when the process that asked for an inspection has ended."""
    for _ in instructions:
        pass
    _leave(2, alone=control.alone)


def _failed(error: BaseException) -> Failed:
    """Return the event for an error, and log its traceback."""
    with contextlib.suppress(Exception):  # an exception of an operator's own may do anything
        traceback.print_exception(error)
    expected = isinstance(error, FoveaError)
    return Failed(said_by(error) if expected else error_text(error), expected)


def _on_thread(process: Process, broken: threading.ExceptHookArgs) -> None:
    """Handle an exception in a thread of an operator as one of the operator."""
    if broken.exc_value is not None and not isinstance(broken.exc_value, SystemExit):
        process.report(broken.exc_value)
        process.stop()


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


def _obey(process: Process, control: Control, instructions: Iterator[Instruction]) -> None:
    for told in instructions:
        if isinstance(told, Go):
            process.go.set()
        elif isinstance(told, Finish):
            process.finish()
        elif isinstance(told, Stop):
            break
        elif isinstance(told, NodeInstruction):
            process.do(told)
    process.stop()
    threading.Event().wait(FAREWELL_S)
    _leave(2, alone=control.alone)


def _summary(node: str, figures: Mapping[str, Any]) -> Summary:
    """Return a node's figures as plain values; none if they exceed the limit."""
    values = json.loads(json.dumps(dict(figures)))
    told = Summary(node, plain(values, most_chars=MOST_EVENT_BYTES))  # a reader cuts them, once
    if (size := len(encode(told))) > MOST_EVENT_BYTES:
        return Summary(node, {}, f"expected up to {MOST_EVENT_BYTES} bytes, got {size}")
    return told


if __name__ == "__main__":
    main()
