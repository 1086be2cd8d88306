"""Hot swap, without a stop: a successor on standby takes over between two frames.

    WARMING        the spare process finishes its imports: two imports cost a graph twice
       | launch the successor
    LOADING        it opens its operator                        ---------------+
       | Ready: writers send to both                                           |
    CONNECTING     its inputs get their handshakes              ---------------+
       | Standing                                                              |
    SHADOWING      if asked: both answer the same frames        ---------------+
       | Shadowed: tell the predecessor to cut                                 | refused: the
    CUTTING        the predecessor stops between two frames     ---------------+ predecessor has
       |   | it does not: tell it not to                                       | worked all the
       |  TAKING_BACK   its cut may cross that order            ---------------+ time
       | CutMade <-'
    TAKING_OVER    the successor goes on from there             --------+
       | TakenOver: switch to it                                        |
    PROVING        its first frames are watched                 --------+ failed: kill it
       | enough frames                                                  |
    ANSWERING      its first answer is awaited                  --------+
       | Answered: confirm                                              |
    DRAINING       what the predecessor sent arrives, then its    KILLING       it ends
       | stop it   sending is refused                                | resume the predecessor
    LEAVING        it ends                                        RESUMING      it works again
       |                                                             |
    DONE                                                          DRAINING_BACK, then refused

`pipeline.node.handover` is the part of the two instances.
"""

import time
from collections.abc import Callable
from enum import Enum, auto

from pipeline.errors import RunError
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import (
    Answered,
    Confirm,
    Cut,
    CutMade,
    CutRefused,
    Resume,
    Resumed,
    Shadowed,
    Standing,
    Stop,
    TakenOver,
    Uncut,
)
from pipeline.run.probation import QUIET_S, Probation
from pipeline.run.process_handle import KILLED_S
from pipeline.run.swap_machine import SwapMachine
from pipeline.run.swap_target import Successor, SwapTarget

CONNECT_S = 10.0
SHADOW_S = 1.0  # time limit per frame
CUT_S = 30.0
UNCUT_S = 0.5  # time in which a cut may cross its cancellation
ANSWER_S = 5.0
DRAIN_S = 5.0


class HotState(Enum):
    """The states of a hot swap, in the diagram above."""

    WARMING = auto()
    LOADING = auto()
    CONNECTING = auto()
    SHADOWING = auto()
    CUTTING = auto()
    TAKING_BACK = auto()
    TAKING_OVER = auto()
    PROVING = auto()
    ANSWERING = auto()
    DRAINING = auto()
    LEAVING = auto()
    DONE = auto()
    KILLING = auto()
    RESUMING = auto()
    DRAINING_BACK = auto()


S = HotState


class HotSwap(SwapMachine[HotState]):
    """One hot swap; `other` is the inactive one of the two instances."""

    hot = True
    DONE = S.DONE
    UNDONE = (S.TAKING_OVER, S.PROVING, S.ANSWERING)

    def __init__(
        self, target: SwapTarget, order: SwapOrder, now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(target, order, S.WARMING, now)
        self._old = target.working()
        self._steps = {
            S.WARMING: self._warming, S.LOADING: self._loading, S.CONNECTING: self._connecting,
            S.SHADOWING: self._shadowing, S.CUTTING: self._cutting,
            S.TAKING_BACK: self._taking_back, S.TAKING_OVER: self._taking_over,
            S.PROVING: self._proving, S.ANSWERING: self._answering, S.DRAINING: self._draining,
            S.LEAVING: self._leaving, S.KILLING: self._killing, S.RESUMING: self._resuming,
            S.DRAINING_BACK: self._draining_back,
        }  # fmt: skip

    def _give_back(self, *, failed: bool) -> None:
        """Clean up: no writer sends to a second instance, and a live predecessor resumes."""
        self._target.send_also_to(0)
        self.owned = False
        if failed and self._target.is_working(self._old):
            self._old.tell(Uncut(self._name))

    # to the successor

    def _warming(self) -> HotState:
        if not self._spare_is_done():
            return S.WARMING
        self._old, self._before = self._target.working(), self._target.plan
        self._plan = self._target.changed(self._order)
        self._new: Successor = self._target.launch_successor(self._plan)
        self.other = self._new.handle
        return S.LOADING

    def _loading(self) -> HotState:
        if not self._beside(self._new.handle.ready, self._target.start_limit_s, "it was not ready"):
            return S.LOADING
        self._target.send_also_to(self._new.epoch)
        return S.CONNECTING

    def _connecting(self) -> HotState:
        standing = self.events.heard(self._new.handle, Standing)
        ready = self._beside(standing, CONNECT_S, "its inputs got no handshake")
        if standing is None or not ready:
            return S.CONNECTING
        self.facts["ready_seq"] = int(self._target.account.last_seq)
        self._heard = standing.heard
        if self._order.shadow:
            self._old.tell(self._cut(shadow=self._order.shadow))
            return S.SHADOWING
        return self._begin_cut()

    def _shadowing(self) -> HotState:
        shadowed = self.events.heard(self._new.handle, Shadowed)
        self._check_cut()
        limit_s = QUIET_S + SHADOW_S * self._order.shadow
        if not self._beside(shadowed, limit_s, "the shadow run did not end") or shadowed is None:
            return S.SHADOWING
        self.facts["shadow"] = shadowed.report
        return self._begin_cut()

    def _cutting(self) -> HotState:
        if self.events.heard(self._old, CutMade):
            return S.TAKING_OVER
        self._check_cut()
        ended = self._old.ended() is not None or self._new.handle.ended() is not None
        if not ended and not self._late(CUT_S):
            return S.CUTTING
        self._old.tell(Uncut(self._name))
        return S.TAKING_BACK

    def _taking_back(self) -> HotState:
        if self.events.heard(self._old, CutMade):
            return S.TAKING_OVER
        if not self._late(UNCUT_S) and not self.events.over(self._old):
            return S.TAKING_BACK
        self.owned = False
        raise RunError(f"{self._name}: it did not reach a frame for the cut")

    def _taking_over(self) -> HotState:
        taken = self.events.heard(self._new.handle, TakenOver)
        self._await(taken, ANSWER_S, "it did not take over", self._new.handle)
        if taken is None:
            return S.TAKING_OVER
        self.facts |= {
            "seq": taken.seq, "gap_ms": taken.gap_ms,
            "state": "begins anew, as asked" if self._order.fresh else taken.state,
            "forgotten": taken.forgotten,
        }  # fmt: skip
        if self._target.told_since():
            raise RunError(f"{self._name}: its settings were changed meanwhile, try again")
        self._target.switch(self._new, self._plan)
        self.other = self._old
        self._probation = Probation(self._target, self._order, self.events, self._now)
        return S.PROVING

    def _proving(self) -> HotState:
        if not self._probation.over(self._new.handle):
            return S.PROVING
        self.facts["proven_frames"] = self._probation.frames
        return S.ANSWERING

    def _answering(self) -> HotState:
        answered = self.events.heard(self._new.handle, Answered)
        if answered is None and self._probation.frames and not self._late(ANSWER_S):
            self.events.check_alive(self._new.handle)
            return S.ANSWERING
        if answered is not None:
            self.facts |= {"left_out": answered.left_out, "answered_ms": answered.answered_ms}
        self._new.handle.tell(Confirm(self._name))
        self._sent = self._target.sent()
        return S.DRAINING

    def _draining(self) -> HotState:
        if not self._target.arrived(self._sent) and not self._late(DRAIN_S):
            return S.DRAINING
        self._target.fence(self._new.epoch)
        self._old.tell(Stop())
        return S.LEAVING

    def _leaving(self) -> HotState:
        return S.DONE if self._old.ended() is not None or self._late(ANSWER_S) else S.LEAVING

    # back to the predecessor

    def _roll_back(self, why: str) -> HotState:
        self._failure = f"{why}; the old instance continues"
        self._new.handle.kill()
        return S.KILLING

    def _killing(self) -> HotState:
        if self._new.handle.ended() is None and not self._late(KILLED_S):
            return S.KILLING
        self._target.dismiss(self._new.handle)
        self.other = None
        self._epoch = self._target.switch_back(self._old, self._before)
        self.facts["rolled_back"] = True
        self._old.tell(Resume(self._name, self._epoch))
        return S.RESUMING

    def _resuming(self) -> HotState:
        resumed = self.events.heard(self._old, Resumed)
        if not self._await(resumed, ANSWER_S, "the old instance did not resume", self._old):
            return S.RESUMING
        self._target.read_by(self._epoch)
        self._sent = self._target.sent()
        return S.DRAINING_BACK

    def _draining_back(self) -> HotState:
        if not self._target.arrived(self._sent) and not self._late(DRAIN_S):
            return S.DRAINING_BACK
        self._target.fence(self._epoch)
        raise RunError(self._failure)

    # what several states do

    def _beside(self, done: object, limit_s: float, what: str) -> bool:
        """Wait as `_await` does for the successor, while its predecessor works."""
        if not self._target.is_working(self._old) or self._old.ended() is not None:
            raise RunError(f"{self._name}: it ended meanwhile and starts again; try again")
        return self._await(done, limit_s, what, self._new.handle)

    def _cut(self, *, at: int = 0, shadow: int = 0) -> Cut:
        return Cut(
            node=self._name, receiver=self._new.receiver, heard=self._heard, at=at, shadow=shadow,
            fresh=self._order.fresh,
        )  # fmt: skip

    def _begin_cut(self) -> HotState:
        self._old.tell(self._cut(at=self._order.at))
        self.owned = True
        return S.CUTTING

    def _check_cut(self) -> None:
        """Raise `RunError` when the predecessor has refused the cut."""
        if refusal := self.events.heard(self._old, CutRefused):
            raise RunError(f"{self._name}: {refusal.reason}")
