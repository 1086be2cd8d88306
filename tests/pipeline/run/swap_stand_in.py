"""A fake swap target without processes: it records calls and returns preset results."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

from pipeline.errors import RunError
from pipeline.protocol.codec import ControlMessage
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Event
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.swap_target import Successor, SwapTarget


@dataclass(eq=False)
class StandInHandle:
    """A stand-in for a process, whose state the test sets."""

    name: str
    pid: int
    ready: bool = False
    going: bool = False
    status: int | None = None
    told: list[str] = field(default_factory=list)
    killed: int = 0

    def ended(self) -> int | None:
        return self.status

    def bury(self) -> None: ...

    def kill(self) -> None:
        self.killed += 1

    def tell(self, message: ControlMessage) -> None:
        self.told.append(type(message).__name__)


class _Histogram:
    counts = SimpleNamespace(copy=lambda: None)
    before_ms = 1.0  # of the predecessor
    slow_ms = 1.0  # of the successor

    def percentile_ms(self, _share: float) -> float:
        return self.before_ms

    def since(self, _counts: object) -> Any:
        return SimpleNamespace(percentile_ms=lambda _share: self.slow_ms)


class StandIn:
    """A stand-in for a `SwapTarget`; `did` lists the calls in order."""

    def __init__(self) -> None:
        self.node = SimpleNamespace(name="work")
        self.plan = "before"
        self.start_limit_s = 60.0
        self.old, self.new = StandInHandle("work", 1, True, True), StandInHandle("work", 2)
        self.works: StandInHandle | None = self.old
        self.did: list[str] = []
        self.spare_warms = self.told = self.run_ends = self.messages_wait = False
        self.has_arrived = True
        self.refuses_to_start = 0
        self.account = SimpleNamespace(
            handled=0, last_seq=7, condition="waiting", histograms={"handler": _Histogram()}
        )

    def working(self) -> StandInHandle:
        if self.works is None:
            raise RunError("work: is not running now, try again")
        return self.works

    def is_working(self, handle: object) -> bool:
        return self.works is handle

    def stalled(self) -> str:
        return ""

    def spare_is_warming(self) -> bool:
        return self.spare_warms

    def drop_spare(self) -> None:
        self.spare_warms = False
        self.did.append("drop_spare")

    def changed(self, _order: SwapOrder) -> str:
        return "after"

    def told_since(self) -> bool:
        return self.told

    def launch_successor(self, _plan: object) -> Successor:
        return Successor(cast(ProcessHandle, self.new), 2, "receiver")

    def launch_trial(self, _plan: object) -> StandInHandle:
        return self.new

    def start(self, plan: object) -> StandInHandle:
        self.did.append(f"start {plan}")
        if self.refuses_to_start:
            self.refuses_to_start -= 1
            raise RunError("work: cannot be started")
        self.works = StandInHandle("work", len(self.did) + 10)
        return self.works

    def let_go(self) -> None:
        assert self.works is not None
        self.works.going = True

    def vacate(self) -> None:
        self.works = None
        self.did.append("vacate")

    def switch(self, successor: Successor, plan: object) -> None:
        self.works = cast(StandInHandle, successor.handle)
        self.did.append(f"switch to {plan}")

    def switch_back(self, old: StandInHandle, before: object) -> int:
        self.works = old
        self.did.append(f"back to {before}")
        return 3

    def sent(self) -> list[int]:
        return [4]

    def arrived(self, _sent: list[int]) -> bool:
        return self.has_arrived

    def __getattr__(self, name: str) -> Any:
        """Return a function that only notes a call which needs no answer."""

        def note(*words: object, **_more: object) -> None:
            self.did.append(" ".join([name, *(str(w) for w in words if isinstance(w, (int, str)))]))

        return note


class Swapping:
    """A swap machine over a stand-in, with a clock of its own."""

    def __init__(self, machine: type[Any], **order: Any) -> None:
        self.target, self.now_s = StandIn(), 100.0
        self.machine = machine(
            cast(SwapTarget, self.target), SwapOrder(**{"node": "work", **order}),
            lambda: self.now_s,
        )  # fmt: skip
        self.events = self.machine.events

    def tick(self, *events: tuple[StandInHandle, Event], later_s: float = 0.0) -> str:
        """Advance by one tick after these events; return the state, or the reason of a refusal."""
        self.now_s += later_s
        for handle, event in events:
            self.events.note(handle.pid, event)
        self.events.tick()
        try:
            self.machine.advance()
        except RunError as error:
            return str(error)
        return str(self.machine.state.name)
