"""Replaces the operator of a running node: stand by, cut, probation, and back when it fails.

The supervisor's side; `pipeline.node.handover` is what the two instances do. A part that shares its
process, or owns a device, cannot stand by: it is stopped, then the other started.
"""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from pipeline.bus.ledger import NodeAccount
from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.node.live import keep, kept
from pipeline.node.wiring import swappable
from pipeline.protocol.orders import ShadowReport, SwapOrder, SwapResult
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import KILLED_S, ProcessHandle, ending
from pipeline.run.process_manager import ProcessManager
from pipeline.settings import suggest
from pipeline.wording import shown_key

START_S = 60.0
SPARE_S = 10.0  # for the spare process to be through with its imports
HEAR_S = 10.0  # for the handshakes of a successor's inputs
CUT_S = 30.0
UNCUT_S = 0.5  # in which a cut may cross the order that takes it back
SHADOW_S = 1.0  # per frame, at most
ANSWER_S = 5.0
LEAVE_S = 1.0  # for a process that only checked whether a part fits
STUCK_S = 2.0  # with messages waiting
LOOK_S = 0.5  # counted between two looks at most: who looks late was stopped like all others
QUIET_S = 10.0  # without messages: then probation is over
DRAIN_S = 5.0
SOONEST = 5  # frames after which a successor may be found too slow
SLOWER, LEAST_BUDGET_MS = 3.0, 20.0  # than the old part, when no budget is given
log = logging.getLogger(__name__)


class SwapOperation(Operation):
    """One swap."""

    kind = "swap"

    def __init__(self, manager: ProcessManager, order: SwapOrder) -> None:
        names = [n.name for n in filter(manager.plan.is_here, manager.plan.nodes)]
        if order.node not in names:
            raise RunError(
                f"{manager.plan.name}: no node {shown_key(order.node)}{suggest(order.node, names)}"
            )
        self._order, self._node = order, manager.plan.node(order.node)
        self._managed = manager.processes[self._node.process]
        if self._managed.handle is None or not self._managed.handle.going:
            raise RunError(f"{order.node}: does not run just now, try again")
        self._other: ProcessHandle | None = None  # the one of the two that does not work
        self._owned = False
        self._gone: set[int] = set()  # pids of who was told to stop
        self._told: dict[str, Any] = {}  # the settings that the old part was given while it ran
        self._hot = swappable(manager.plan, self._node) and not self._managed.sources
        super().__init__(manager, self._swap_hot() if self._hot else self._swap_cold())
        self.subject = order.node
        self.facts |= {"node": order.node, "hot": self._hot}

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether exits of that process belong to this swap."""
        return self._owned and managed is self._managed

    def on_event(self, pid: int, event: dict[str, Any]) -> bool:
        """Take note of an event; True when nobody else needs it."""
        kind = str(event.get("event"))
        if pid in self._gone:
            return True
        mine = [c for c in (self._other, self._managed.handle) if c and c.pid == pid]
        if not mine:
            return False
        super().on_event(pid, event)
        if mine[0] is self._other and kind == "ready":
            mine[0].ready, mine[0].load_s = True, float(event.get("load_s", 0))
        return mine[0] is self._other or (self._owned and kind == "failed")

    def abort(self) -> list[ProcessHandle]:
        """The run ends: the process that does not work, to be ended with the others."""
        return [self._other] if self._other else []

    def done(self) -> SwapResult:
        """What was swapped, and how."""
        return SwapResult(**self.facts)

    def _finish(self, why: str) -> None:
        if self._other is not None:
            self.manager.dismiss(self._other)
            self._other = None
        for account in self.manager.accounts(self._managed):
            account.next_receiver_epoch = 0
        owned, self._owned = self._owned, False
        if owned and self._managed.handle is None and not self._managed.next_start_s:
            self._managed.next_start_s = (
                time.monotonic()
            )  # it could not be started: the manager retries
        if why and self._hot and self._managed.handle is not None:
            self._managed.handle.order("uncut", node=self._node.name)
        super()._finish(why)

    # hot: a successor stands by

    def _swap_hot(self) -> Iterator[None]:
        manager, managed, order = self.manager, self._managed, self._order
        yield from self._spare()
        old, before, plan = self._working(), manager.plan, self._changed()
        epoch = managed.promise()
        job = manager.job(managed, plan, epoch, standby=True, checked=True)
        new = self._other = manager.launch(job, fresh=True)
        yield from self._beside(old, lambda: new.ready, START_S, "it was not ready")
        receiver = job.receiver(self._node.name, epoch)
        for account in manager.accounts(managed):
            account.next_receiver_epoch = epoch
        yield from self._beside(
            old, lambda: "standing" in self.heard(new), HEAR_S, "its inputs got no handshake"
        )
        heard = self.heard(new)["standing"]["heard"]
        self.facts["ready_seq"] = int(self._account().last_seq)
        cut = {"receiver": str(receiver), "heard": heard, "at": order.at}
        if order.shadow:
            yield from self._try(old, new, {**cut, "at": 0, "shadow": order.shadow})
        old.order("cut", node=self._node.name, cut=cut)
        yield from self._cut(old, new)
        try:
            yield from self.until(
                lambda: "taken" in self.heard(new),
                ANSWER_S,
                "it did not take over",
                of=new,
            )
            taken = self.heard(new)["taken"]
            self.facts |= {k: taken[k] for k in ("seq", "gap_ms", "state", "forgotten")}
            self._switch(new, old, plan, epoch)
            yield from self._probation(new)
            if self.facts["proven_frames"]:
                yield from self.until(
                    lambda: "answered" in self.heard(new), ANSWER_S, "", of=new, must=False
                )
        except RunError as error:
            yield from self._roll_back(new, old, before, managed.promise())
            raise RunError(f"{error}; the old part goes on") from error
        answered = self.heard(new).get("answered", {})
        self.facts |= {k: answered[k] for k in ("left_out", "answered_ms") if k in answered}
        new.order("confirm", node=self._node.name)
        yield from self._drained(epoch)
        old.tell("stop")
        yield from self.until(lambda: old.ended() is not None, ANSWER_S, "", must=False)

    def _spare(self) -> Iterator[None]:
        """Let a process that is half through with its imports finish them: two cost twice."""
        spare = self.manager.spare
        spare.refresh()
        yield from self.until(lambda: not spare.warming, SPARE_S, "", must=False)
        if spare.warming:  # it hangs
            spare.dismiss()

    def _beside(
        self, old: ProcessHandle, done: Callable[[], bool], limit_s: float, what: str
    ) -> Iterator[None]:
        """Wait for something of the successor, for as long as the old part works."""

        def gone() -> bool:
            return self._managed.handle is not old or old.ended() is not None

        yield from self.until(lambda: done() or gone(), limit_s, what, of=self._other)
        if gone():
            raise RunError(f"{self._node.name}: it ended meanwhile and starts again; try again")

    def _try(self, old: ProcessHandle, new: ProcessHandle, cut: dict[str, Any]) -> Iterator[None]:
        """Let the successor answer the same frames, and keep what came of it."""
        old.order("cut", node=self._node.name, cut=cut)
        limit_s = QUIET_S + SHADOW_S * cut["shadow"]
        heard = self.heard(old)
        yield from self._beside(
            old, lambda: "shadowed" in self.heard(new) or "uncut" in heard, limit_s,
            "the shadow run did not end",
        )  # fmt: skip
        if "uncut" in heard:
            raise RunError(f"{self._node.name}: {heard['uncut']['reason']}")
        told = self.heard(new)["shadowed"]
        report = {k: v for k, v in told.items() if k not in ("event", "node")}
        self.facts["shadow"] = msgspec.convert(report, ShadowReport)

    def _cut(self, old: ProcessHandle, new: ProcessHandle) -> Iterator[None]:
        """Wait until the old part has stopped, or let it go on."""
        heard, name = self.heard(old), self._node.name
        late_s = time.monotonic() + CUT_S
        self._owned = True
        while "cut" not in heard:
            if "uncut" in heard:
                raise RunError(f"{name}: {heard['uncut']['reason']}")
            if old.ended() is not None or new.ended() is not None or time.monotonic() > late_s:
                old.order("uncut", node=name)
                if old.ended() is None:
                    yield from self.until(lambda: "cut" in heard, UNCUT_S, "", must=False)
                else:
                    yield from self.last_words(old)
                if "cut" in heard:
                    return
                self._owned = False
                raise RunError(f"{name}: it did not come to a frame where it could be cut")
            yield

    def _switch(self, new: ProcessHandle, old: ProcessHandle, plan: Plan, epoch: int) -> None:
        manager, managed = self.manager, self._managed
        if kept(self._live_file()) != self._told:
            raise RunError(f"{self._node.name}: its settings were changed meanwhile, try again")
        for account in manager.accounts(managed):
            account.reader_epoch = epoch
            account.next_receiver_epoch, account.receiver_epoch = account.receiver_epoch, epoch
        managed.handle, managed.epoch, self._other = new, epoch, old
        new.going, managed.going_since_s = True, time.monotonic()
        new.tell("go")
        self._live_file().unlink(missing_ok=True)
        manager.change_plan(plan)

    def _roll_back(
        self, new: ProcessHandle, old: ProcessHandle, before: Plan, epoch: int
    ) -> Iterator[None]:
        manager, managed, name = self.manager, self._managed, self._node.name
        new.kill()
        yield from self.until(lambda: new.ended() is not None, KILLED_S, "", must=False)
        self.manager.dismiss(new)
        switched = managed.handle is new
        managed.handle, self._other = old, None
        if switched:
            for account in manager.accounts(managed):
                account.receiver_epoch, account.next_receiver_epoch = account.next_receiver_epoch, 0
            manager.change_plan(before)
            self._keep_again()
        managed.epoch = epoch
        self.facts["rolled_back"] = True
        old.order("resume", node=name, epoch=epoch)
        yield from self.until(
            lambda: "resumed" in self.heard(old),
            ANSWER_S,
            "the old part did not go on",
            of=old,
        )
        for account in manager.accounts(managed):
            account.reader_epoch = epoch
        yield from self._drained(epoch)

    def _drained(self, epoch: int) -> Iterator[None]:
        """Fence the other off, once what it had sent by right has arrived."""
        accounts = self.manager.accounts(self._managed, outgoing=True)
        sent = [account.sent for account in accounts]
        late_s = time.monotonic() + DRAIN_S
        while time.monotonic() < late_s and any(
            a.live and a.seen < s for a, s in zip(accounts, sent, strict=True)
        ):
            yield
        for account in accounts:
            account.writer_epoch = epoch

    # cold: stopped, then started

    def _swap_cold(self) -> Iterator[None]:
        yield from self._spare()
        before = self.manager.plan
        job = self.manager.job(self._managed, self._changed(), self._managed.epoch, trial=True)
        trial = self._other = self.manager.launch(job, fresh=True)
        yield from self.until(
            lambda: "fits" in self.heard(trial), START_S, "it was not checked", of=trial
        )
        self._other = None
        self.manager.dismiss(trial, LEAVE_S)
        yield from self._spare()  # while it waits nobody stands still
        self._owned = True
        yield from self._stop()
        plan = self._changed()  # with all that it was told until its end
        self._live_file().unlink(missing_ok=True)
        try:
            self.facts["state"] = "begins anew: it was stopped and started"
            yield from self._start(plan)
            yield from self._probation(self._working())
        except RunError as error:
            self.facts["rolled_back"] = True
            self._keep_again()
            if self._managed.handle is not None:
                yield from self._stop()
                self._keep_again()  # without what the new part was told
            yield from self._start(before)
            raise RunError(f"{error}; the old part was started again") from error

    def _stop(self) -> Iterator[None]:
        handle = self._working()
        self._stopped_s = time.monotonic()
        self._gone.add(handle.pid)
        handle.tell("stop")
        yield from self.until(lambda: handle.ended() is not None, ANSWER_S, "", must=False)
        handle.kill()
        yield from self.until(lambda: handle.ended() is not None, KILLED_S, "", must=False)
        self.manager.vacate(self._managed)

    def _start(self, plan: Plan) -> Iterator[None]:
        manager, managed = self.manager, self._managed
        handled = self._account().handled
        manager.begin(managed, plan=plan, checked=True)
        handle = self._working()
        yield from self.until(lambda: handle.ready, START_S, "it was not ready", of=handle)
        manager.change_plan(plan)

        def works() -> bool:
            if not handle.going:
                manager.let_go(managed)
            return handle.going and self._account().handled > handled

        yield from self.until(works, QUIET_S, "", of=handle, must=False)
        self.facts["gap_ms"] = round(1000 * (time.monotonic() - self._stopped_s), 1)

    # both

    def _changed(self) -> Plan:
        """The plan with the new operator and settings in the old place."""
        manager, order, node = self.manager, self._order, self._node
        self._told = kept(self._live_file())
        settings = {} if order.defaults else {**node.settings, **self._told}
        fresh = replace(
            node, operator=order.operator or node.operator, settings={**settings, **order.changes}
        )
        return replace(
            manager.plan,
            nodes=tuple(fresh if n.name == node.name else n for n in manager.plan.nodes),
        )

    def _probation(self, handle: ProcessHandle) -> Iterator[None]:
        """Watch the successor's first frames; raises `RunError` when it is not good enough."""
        node, account, wanted = self._node.name, self._account(), self._order.probation
        first, earlier = account.handled, self._account().histograms["handler"].counts.copy()
        budget_ms = self._order.budget_ms or max(
            LEAST_BUDGET_MS, SLOWER * account.histograms["handler"].percentile_ms(0.5)
        )
        stuck_s = max(STUCK_S, self._order.budget_ms / 1000)
        still_s, seen_s, handled = 0.0, time.monotonic(), first
        while handled - first < wanted and not self.manager.finished:
            yield
            if (status := handle.ended()) is not None:
                yield from self.last_words(handle)
                said = self.heard(handle).get("failed", {}).get("error", "")
                raise RunError(f"{node}: the new part ended by {ending(status)} {said}".rstrip())
            if problem := self.manager.stalled(self._managed):
                raise RunError(problem)
            seen_s, before_s = time.monotonic(), seen_s
            still_s += min(seen_s - before_s, LOOK_S)
            if account.handled != handled:
                still_s, handled = 0.0, account.handled
                times = account.histograms["handler"].since(earlier)
                slow = times.percentile_ms(0.5)
                if handled - first >= min(SOONEST, wanted) and slow > budget_ms:
                    raise RunError(
                        f"{node}: the new part takes {slow:.1f} ms a frame, expected at most "
                        f"{budget_ms:.1f} ms"
                    )
            waiting = any(a.in_flight for a in self.manager.accounts(self._managed))
            if still_s > stuck_s and waiting and account.condition != "credit":
                raise RunError(f"{node}: the new part finished no frame for {still_s:.1f} s")
            if still_s > QUIET_S:
                break
        self.facts["proven_frames"] = int(account.handled - first)

    def _keep_again(self) -> None:
        """Should the old part die, it comes back with what it had been told."""
        try:
            if self._told:
                keep(self._live_file(), self._told)
            else:
                self._live_file().unlink(missing_ok=True)
        except OSError as error:
            log.warning("%s: its settings cannot be kept: %s", self._node.name, error)

    def _working(self) -> ProcessHandle:
        if self._managed.handle is None:
            raise RunError(f"{self._node.name}: does not run just now, try again")
        return self._managed.handle

    def _account(self) -> NodeAccount:
        return self.manager.ledger.nodes[self._node.index]

    def _live_file(self) -> Path:
        return self.manager.live_file(self._node.name)
