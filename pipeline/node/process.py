"""A node process: a plan on its standard input, operators of one group run until told to stop.

The supervisor speaks over a socket (`go`, `finish`, `stop`, end of file: it died) and hears events
as JSON lines, the last of them `leaving`; everything an operator prints goes to the log.
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
from pipeline.class_cache import adapter
from pipeline.contract import Operator, Source, settings_of
from pipeline.errors import FoveaError
from pipeline.graph.plan import Node, Plan, load_operator
from pipeline.node.control import Control
from pipeline.node.handover import read_cut
from pipeline.node.logfile import log_to
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.port_contract import check_fit
from pipeline.node.source import SourceRunner
from pipeline.node.wiring import ASIDE, Assignment, Wiring
from pipeline.private_folder import PrivateFolder
from pipeline.text import error_text, said_by

ASIDE_NICENESS = 5  # of processes that no sensor command waits for
AHEAD_NICENESS = 19  # of imports that nobody waits for yet
HEADLINE_S = 1.0  # between two looks at what operators have to tell
FAREWELL_S = 3.0  # after this the process ends whatever an operator does
log = logging.getLogger(__name__)


class Process:
    """The nodes of one group in this process."""

    def __init__(
        self, job: Assignment, say: Callable[..., None], look: Callable[[], None] = lambda: None
    ) -> None:
        """`say` tells the supervisor of an event; `look` is called about once a second."""
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
                return self.say("fits")
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
            gc.freeze()  # what is loaded by now stays: no collection has to walk through it again
            self.say("ready", load_s=loaded_s - began_s)
            self._run_all()
        except BaseException as error:  # an operator may raise SystemExit, a library panic
            self.report(error)
        finally:
            self._close()

    def _check(self) -> None:
        """A part that is new in a running graph has to fit before anything is opened."""
        for node in self._nodes:
            if contract := self._job.contracts.get(node.name):
                check_fit(self._job.plan, node, contract)
                self._make(node)

    def stop(self) -> None:
        """Let every runner return."""
        self.go.set()
        for runner in self._runners:
            runner.stop()

    def finish(self) -> None:
        """Sources make no more frames."""
        for runner in self._runners:
            if isinstance(runner, SourceRunner):
                runner.end()

    def do(self, order: Mapping[str, Any]) -> None:
        """What the supervisor wants of one node, done between two calls of its handlers."""
        kind, node = order.get("do"), str(order.get("node"))
        runner = next((h for h in self._runners if h.name == node), None)
        if runner is not None and kind == "replan" and self._wiring is not None:
            plan = adapter(Plan).validate_python(order["plan"])
            runner.between(partial(self._wiring.replan, node, plan), must=True)
            return
        handover = self._wiring.handovers.get(node) if self._wiring else None
        if runner is None or handover is None:
            log.error("%s: cannot %s %s", self._job.process, kind, node)
        elif kind == "cut":
            runner.between(partial(handover.request, read_cut(order["cut"])), must=True)
        elif kind == "uncut":
            runner.between(partial(handover.request, None), must=True)
        elif kind == "resume":
            runner.between(partial(handover.resume, int(order["epoch"])), must=True)
        elif kind == "confirm":
            runner.between(handover.confirm, must=True)

    def _make(self, node: Node) -> Operator[Any, Any]:
        cls = load_operator(node.operator)
        operator = cls(checked.build(settings_of(cls), self._job.settings(node), node.name))
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
            for thread in threads:
                while thread.is_alive():
                    thread.join(HEADLINE_S)
                    self._look()
                    self._tell_headlines()
        finally:
            self.stop()
            for thread in threads:
                thread.join(FAREWELL_S)

    def _tell_headlines(self) -> None:
        for node, operator in zip(self._nodes, self._operators, strict=True):
            words = str(operator.headline())
            if words != self._headlines.get(node.name, ""):
                self._headlines[node.name] = words
                self.say("headline", node=node.name, words=words)

    def _guard(self, runner: OperatorRunner) -> None:
        try:
            if isinstance(runner, SourceRunner):
                runner.on_finished = lambda: self.say("finished", node=runner.name)
                while not self.go.is_set():
                    runner.attend()
            runner.run()
        except BaseException as error:  # an operator may raise SystemExit, a library panic
            self.report(error)
            self.stop()

    def report(self, error: BaseException) -> None:
        """Tell the first error, which is the reason; what breaks after it is in the log.

        The log has each with its traceback.
        """
        with contextlib.suppress(Exception):  # an exception of an operator's own may do anything
            traceback.print_exception(error)
        expected = isinstance(error, FoveaError)
        if not self.failed:
            said = said_by(error) if expected else error_text(error)
            self.say("failed", error=said, expected=expected)
        self.failed = True

    def _tell_summary(self, node: Node, operator: Operator[Any, Any]) -> None:
        self.say("summary", node=node.name, figures=_plain(operator.summary()))

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
                self.say("summary", node=runner.name, figures=runner.figures())
        if self._wiring is not None:
            self._wiring.close()
        for session in (self._session, self._border):
            if session is not None:
                session.close()


def main() -> None:
    """Read an assignment, do it, announce the end, leave with 0 or 1."""
    control = Control.from_standard_input()
    try:
        failed = _work(control)
    except BaseException as error:  # before there is an operator to blame
        traceback.print_exc()
        control.say("failed", error=error_text(error), expected=False)
        failed = True
    control.say("leaving")
    _leave(1 if failed else 0, alone=control.alone)


def _work(control: Control) -> bool:
    """Do what the supervisor assigns; whether it failed."""
    loader = threading.Thread(target=_import_ahead, args=(sys.argv[2:],))
    loader.start()
    loader.join()
    _level()
    control.say("idle")
    lines = control.lines()
    line = next(lines, "")
    if not line:
        _leave(0, alone=True)  # a spare that was not needed
    job = adapter(Assignment).validate_json(line)
    first = max(job.epochs.values()) == 1 and not job.trial
    file = log_to(Path(job.run_folder) / f"{job.process}.log", fresh=first)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    faulthandler.register(signal.SIGUSR1, file)  # asked for before a stalled node is killed
    sys.setswitchinterval(0.001)  # a thread that delivers must not wait 5 ms for the interpreter
    path = job.plan.command_path()
    if path and not any(n.name in path for n in job.nodes):
        os.nice(ASIDE_NICENESS)

    def look() -> None:
        with contextlib.suppress(OSError):
            file.look()

    process = Process(job, control.say, look)
    threading.excepthook = partial(_on_thread, process)
    threading.Thread(target=_obey, args=(process, control, lines), daemon=True).start()
    process.run()
    return process.failed


def _on_thread(process: Process, broken: threading.ExceptHookArgs) -> None:
    """A thread that an operator started has broken: so has the operator."""
    if broken.exc_value is not None and not isinstance(broken.exc_value, SystemExit):
        process.report(broken.exc_value)
        process.stop()


def _leave(status: int, *, alone: bool) -> NoReturn:
    """End this process, and without a supervisor to do it also what it has started."""
    if alone and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(status)  # Zenoh's threads would keep the interpreter waiting


def _import_ahead(modules: Iterable[str]) -> None:
    """Load what a restarted operator will need; who fails here will say so when it is used.

    On Linux niceness belongs to a thread: the graph that runs keeps its cores meanwhile.
    """
    wanted = set(modules)
    if ASIDE in wanted:
        os.nice(AHEAD_NICENESS)
    for module in sorted(wanted - {ASIDE}):
        with contextlib.suppress(Exception):
            importlib.import_module(module)


def _level() -> None:
    """Let threads that were born in an import run like all others, where that may be asked for."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, int(thread), os.getpriority(os.PRIO_PROCESS, 0))


def _obey(process: Process, control: Control, lines: Iterator[str]) -> None:
    for line in lines:
        word = line.strip()
        if word == "go":
            process.go.set()
        elif word == "finish":
            process.finish()
        elif word == "stop":
            break
        elif word.startswith("{"):
            process.do(json.loads(word))
    process.stop()
    threading.Event().wait(FAREWELL_S)
    _leave(2, alone=control.alone)


def _plain(figures: Mapping[str, Any]) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(json.dumps(dict(figures)))
    return plain


if __name__ == "__main__":
    main()
