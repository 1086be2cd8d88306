"""Queues and joins in front of an operator: arrivals in, complete sets of one exposure out.

Joined inputs are matched on equal `seq`. Streams are ordered, so once an input has delivered frame
k+1, its frame k will never come: a set that waits for it is dropped at once, and its members count
as unmatched. The inbox has no thread and no clock: the caller passes the time.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple

from pipeline.bus.clocks import Clocks
from pipeline.bus.outport import Arrival
from pipeline.contract import Input
from pipeline.messages import Header, Message

GRACE_NS = 1_000_000_000  # after a loss: earlier frames that are not lost arrive within this time
# input, outcome ("delivered" or a drop's name), ordinal
Acknowledge = Callable[[str, str, int], None]

AgeNs = Callable[[Header, int], int | None]  # age of an exposure; None if unknown


class Work(NamedTuple):
    """One call of a handler; with `answer` False, send on that this exposure has no message."""

    header: Header
    messages: Mapping[str, Message | None]  # by input name, in the handler's order
    arrived: Mapping[str, int]  # arrivals to acknowledge: input -> ordinal
    answer: bool
    new_stream: bool = False


class InboxPosition(NamedTuple):
    """The progress of an inbox."""

    stream: str
    retired: list[str]
    handled: int  # the newest seq a handler was called for
    last: dict[str, int]  # the newest seq by input


class _Set:
    """The arrivals of one exposure."""

    __slots__ = ("arrivals", "complete_ns")

    def __init__(self) -> None:
        self.arrivals: dict[str, Arrival] = {}
        self.complete_ns: int | None = None  # when the last required member arrived


class Inbox:
    """The joins and queues of one operator; not thread-safe."""

    def __init__(
        self, inputs: Mapping[str, Input], acknowledge: Acknowledge, *, lockstep: bool,
        age_ns: AgeNs | None = None,
    ) -> None:  # fmt: skip
        self.inputs, self._acknowledge, self._lockstep = dict(inputs), acknowledge, lockstep
        self._age_ns = age_ns or Clocks().age_ns
        self._joined = tuple(n for n, i in inputs.items() if i.join and not i.command)
        self._required = tuple(n for n in self._joined if not inputs[n].optional)
        self._needed = frozenset(self._required)
        self._every = lockstep or any(inputs[n].keep == "every" for n in self._joined)
        depths = [inputs[n].depth for n in self._joined] or [1]
        # lossless writers stop on their own, with at most one message beyond the depth
        self._depth = sum(d + 1 for d in depths) if self._every else max(depths)
        self._wait_ns = max((int(inputs[n].wait_ms * 1e6) for n in self._joined), default=0)
        self._stale_ns = 0 if lockstep else _limit_ns(inputs[n] for n in self._joined)
        self._sets: dict[int, _Set] = {}
        self._last: dict[str, int] = {}
        self._handled = -1
        self._doomed = deque[tuple[int, int]]()  # (when, seq): drop incomplete sets up to it
        self._stream, self._retired = "", deque[str](maxlen=16)
        self._fresh = False
        self._side: deque[tuple[str, Arrival]] = deque()

    def offer(self, name: str, arrival: Arrival, now_ns: int) -> None:
        """Add an arrival."""
        header = arrival.header
        if header.stream != self._stream and not self._change_stream(
            name, header.stream, arrival.ordinal
        ):
            return
        if name not in self._joined:
            self._offer_side(name, arrival)
            return
        seq = header.seq
        self._last[name] = seq
        if seq <= self._handled:
            self._acknowledge(name, "unmatched", arrival.ordinal)
        else:
            waiting = self._sets.get(seq)
            if waiting is None:
                waiting = self._sets[seq] = _Set()
            arrivals = waiting.arrivals
            if name in arrivals:  # its writer died before it recorded having sent this
                self._acknowledge(name, "unmatched", arrivals[name].ordinal)
            arrivals[name] = arrival
            if waiting.complete_ns is None and arrivals.keys() >= self._needed:
                waiting.complete_ns = now_ns
        if len(self._joined) > 1:
            self._give_up(lambda s: any(self._never(n, s) for n in self._required))
        while len(self._sets) > self._depth:
            self._drop(min(self._sets), "unmatched")

    def lost(self, name: str, now_ns: int) -> None:
        """Record a loss on the way to an input: its member of a waiting set may never come.

        Otherwise two lossless inputs with a common source could deadlock: one waits for the lost
        frame, while the writer of the other waits for room in the queue.
        """
        lacking = [s for s, waiting in self._sets.items() if name not in waiting.arrivals]
        newest = self._doomed[-1][1] if self._doomed else -1
        if name in self._needed and max(lacking, default=-1) > newest:
            self._doomed.append((now_ns + GRACE_NS, max(lacking)))

    def take(self, now_ns: int) -> Work | None:
        """Return the next call to make; None while no set is complete."""
        while self._doomed and now_ns >= self._doomed[0][0]:
            _, newest = self._doomed.popleft()
            self._give_up(partial(self._hopeless, newest))
        if self._side and self._side_may_go():
            name, arrival = self._side.popleft()
            return self._work(arrival.header, {name: arrival})
        if not self._sets:
            return None
        ready = [s for s in sorted(self._sets) if self._complete(s, now_ns)]
        if not ready:
            return None
        seq = ready[0] if self._every else ready[-1]
        if len(self._sets) > 1:
            for older in [s for s in self._sets if s < seq]:
                self._drop(older, "superseded" if older in ready else "unmatched")
        waiting = self._sets.pop(seq)
        self._handled = seq
        header = next(iter(waiting.arrivals.values())).header
        if self._stale_ns and (self._age_ns(header, now_ns) or 0) > self._stale_ns:
            for name, arrival in waiting.arrivals.items():
                self._acknowledge(name, "stale", arrival.ordinal)
            return Work(header, {}, {}, answer=False, new_stream=self._once_fresh())
        return self._work(header, waiting.arrivals)

    def due_ns(self) -> int | None:
        """Return when a set stops waiting for optional or lost members; None if no set does."""
        times = [
            s.complete_ns + self._wait_ns for s in self._sets.values() if s.complete_ns is not None
        ]
        if self._doomed:
            times.append(self._doomed[0][0])
        return min(times) if times and not self._lockstep else None

    @property
    def capacity(self) -> int:
        """Return the capacity of one input in arrivals."""
        return self._depth

    def position(self) -> "InboxPosition":
        """Return the progress for a successor, without the waiting arrivals."""
        last = dict(self._last)
        for seq, waiting in self._sets.items():
            for name in waiting.arrivals:
                last[name] = min(last[name], seq - 1)
        return InboxPosition(self._stream, list(self._retired), self._handled, last)

    def go_on_from(self, position: "InboxPosition") -> None:
        """Continue where another inbox stopped; offer its waiting arrivals again."""
        self._stream, self._handled = position.stream, position.handled
        self._last = dict(position.last)
        self._retired.extend(position.retired)
        self._fresh = False

    def abandon(self, name: str) -> None:
        """Drop the waiting arrivals of an input that was connected to another output."""
        for waiting in self._sets.values():
            arrival = waiting.arrivals.pop(name, None)
            if arrival is not None:
                self._acknowledge(name, "unmatched", arrival.ordinal)
                waiting.complete_ns = None
        self._sets = {seq: waiting for seq, waiting in self._sets.items() if waiting.arrivals}
        for entry in [entry for entry in self._side if entry[0] == name]:
            self._side.remove(entry)
            self._acknowledge(name, "unmatched", entry[1].ordinal)
        self._last.pop(name, None)

    def forget(self, done: Callable[[str, int], bool]) -> None:
        """Discard the arrivals (input, ordinal) that another instance has acknowledged."""
        for seq, waiting in list(self._sets.items()):
            for name in [n for n, a in waiting.arrivals.items() if done(n, a.ordinal)]:
                del waiting.arrivals[name]
            if not waiting.arrivals:
                del self._sets[seq]
        left = [entry for entry in self._side if not done(entry[0], entry[1].ordinal)]
        self._side.clear()
        self._side.extend(left)

    def __len__(self) -> int:
        return len(self._sets) + len(self._side)

    def _work(self, header: Header, arrivals: Mapping[str, Arrival]) -> Work:
        names = self._joined if next(iter(arrivals)) in self._joined else tuple(arrivals)
        messages = {n: arrivals[n].message if n in arrivals else None for n in names}
        needed = self._required if names == self._joined else names
        answer = not [n for n in needed if messages[n] is None]
        arrived = {name: arrival.ordinal for name, arrival in arrivals.items()}
        return Work(header, messages, arrived, answer, self._once_fresh())

    def _once_fresh(self) -> bool:
        fresh, self._fresh = self._fresh, False
        return fresh

    def _change_stream(self, name: str, stream: str, ordinal: int) -> bool:
        """Switch to another stream; return False if it is one that had ended before."""
        if stream in self._retired:
            self._acknowledge(name, "unmatched", ordinal)
            return False
        if self._stream:
            self._retired.append(self._stream)
        self._stream, self._fresh, self._handled = stream, True, -1
        self._last.clear()
        self._doomed.clear()
        self._give_up(lambda _seq: True)
        while self._side:
            name, arrival = self._side.popleft()
            self._acknowledge(name, "unmatched", arrival.ordinal)
        return True

    def _offer_side(self, name: str, arrival: Arrival) -> None:
        given = self.inputs[name]
        if not self._lockstep and (given.tap or given.keep == "latest"):
            room = given.depth if given.keep == "every" else 1
            waiting = [entry for entry in self._side if entry[0] == name]
            for older in waiting[: max(0, len(waiting) + 1 - room)]:
                self._side.remove(older)
                self._acknowledge(name, "superseded", older[1].ordinal)
        self._side.append((name, arrival))

    def _side_may_go(self) -> bool:
        """Whether a side input may run: in lockstep the set of its frame comes first."""
        first = self._side[0][1].header.seq
        return not self._lockstep or not self._joined or first <= self._handled

    def _never(self, name: str, seq: int) -> bool:
        return self._last.get(name, -1) >= seq and name not in self._sets[seq].arrivals

    def _complete(self, seq: int, now_ns: int) -> bool:
        waiting = self._sets[seq]
        if waiting.complete_ns is None:
            return False
        if len(waiting.arrivals) == len(self._joined):
            return True
        absent = [n for n in self._joined if n not in waiting.arrivals and not self._never(n, seq)]
        late = not self._lockstep and now_ns - waiting.complete_ns >= self._wait_ns
        return not absent or late

    def _give_up(self, doomed: Callable[[int], bool]) -> None:
        for seq in [s for s in self._sets if doomed(s)]:
            self._drop(seq, "unmatched")

    def _hopeless(self, newest: int, seq: int) -> bool:
        return seq <= newest and self._sets[seq].complete_ns is None

    def _drop(self, seq: int, reason: str) -> None:
        for name, arrival in self._sets.pop(seq).arrivals.items():
            self._acknowledge(name, reason, arrival.ordinal)


def _limit_ns(inputs: Iterable[Input]) -> int:
    """Return the smallest age limit of the inputs that drop stale messages; 0: none."""
    limits = [i.max_age_ms for i in inputs if i.max_age_ms and i.stale == "drop"]
    return int(min(limits, default=0) * 1e6)
