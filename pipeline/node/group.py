"""The nodes of one group in this process: opened, run in a thread each, stopped and closed.

The supervisor's instructions are passed to the operators' threads; what happens to them becomes
events (`pipeline.protocol.supervision`).
"""

import contextlib
import gc
import json
import logging
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.bus.ledger import Ledger
from pipeline.bus.session import Session
from pipeline.cause import cause_of
from pipeline.contract import Operator, Source, settings_of
from pipeline.errors import FoveaError
from pipeline.executor import open_operator
from pipeline.graph.plan import Node, load_operator
from pipeline.node.handover import Say
from pipeline.node.inspection import imported
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.port_contract import check_fit
from pipeline.node.source import SourceRunner
from pipeline.node.wiring import Wiring
from pipeline.node.wiring import settings_of as node_settings
from pipeline.private_folder import PrivateFolder
from pipeline.protocol.codec import encode
from pipeline.protocol.supervision import (
    MOST_EVENT_BYTES,
    Assignment,
    Confirm,
    Cut,
    Failed,
    Finished,
    Fits,
    Headline,
    NodeInstruction,
    Ready,
    Replan,
    Resume,
    Summary,
    Uncut,
)
from pipeline.text import harmless, plain, said_by

HEADLINE_S = 1.0  # interval of headlines
FAREWELL_S = 3.0  # after this time the process ends, whatever operators do
log = logging.getLogger(__name__)


class Group:
    """The nodes of one group, from their opening to their end."""

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
        self._ending = threading.Event()
        self.go = threading.Event()
        self.failed = False

    def run(self) -> None:
        """Open everything, run until stopped, close everything."""
        try:
            self._check()
            if self._job.trial:
                return self.say(Fits(imported(self._nodes)))
            if self._open():
                self._run_all()
        except BaseException as error:  # an operator may raise SystemExit, a library panic
            self.report(error)
        finally:
            self._close()

    def _open(self) -> bool:
        """Open and connect every operator; return False, without the rest, if it has to stop."""
        began_s = time.monotonic()
        for node in self._nodes:
            if self._ending.is_set():
                return False
            if not self._job.standby:
                account = self._ledger.nodes[node.index]
                account.epoch = self._job.epochs[node.name]
                account.enter("starting")
            self._operators.append(self._make(node))
            open_operator(node.name, self._operators[-1])
        if self._ending.is_set():
            return False
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
        if self._ending.is_set():  # tested after the runners are set, as `stop` tests them after it
            return False
        self.say(Ready(loaded_s - began_s, imported(self._nodes)))
        return True

    def _check(self) -> None:
        """Check contracts of an operator that is new in a running graph, before opening."""
        for node in self._nodes:
            contract = self._job.contracts.get(node.name)
            if contract:
                check_fit(self._job.plan, node, contract)
            if contract or self._job.trial:
                self._make(node)

    def stop(self) -> None:
        """Make every runner return; while operators are opened: close them instead of running."""
        self._ending.set()  # runners that do not exist yet could not be told
        for runner in self._runners:
            runner.stop()
        self.go.set()  # last, so that a source which waits for it makes no exposure

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
        told = failure(error)
        if not self.failed:
            self.say(told)
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


def failure(error: BaseException) -> Failed:
    """Return the event for an error, and log its traceback."""
    with contextlib.suppress(Exception):  # an exception of an operator's own may do anything
        traceback.print_exception(error)
    expected = isinstance(error, FoveaError)
    return Failed(said_by(error) if expected else cause_of(error), expected)


def _summary(node: str, figures: object) -> Summary:
    """Return a node's figures as plain values, without those that JSON cannot hold.

    There are none if they are no mapping, or exceed the limit.
    """
    if not isinstance(figures, Mapping):
        return Summary(node, {}, f"summary() returned {type(figures).__name__}, no mapping")
    values: dict[str, Any] = {}
    left_out: list[str] = []
    for name, value in figures.items():
        try:
            values |= json.loads(json.dumps({name: value}))
        except (TypeError, ValueError, RecursionError) as error:
            left_out.append(f"without {harmless(_text(name))}: {harmless(said_by(error))}")
    kept = plain(values, most_chars=MOST_EVENT_BYTES)  # a reader cuts them, once
    told = Summary(node, kept, "; ".join(left_out))
    if (size := len(encode(told))) > MOST_EVENT_BYTES:
        return Summary(node, {}, f"expected up to {MOST_EVENT_BYTES} bytes, got {size}")
    return told


def _text(name: object) -> str:
    """Return a figure's name; that of a class for anything else, whose `str` may do anything."""
    return name if isinstance(name, str) else f"a {type(name).__name__}"
