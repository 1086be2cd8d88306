"""Joins: exact on seq, bounded, every arrival acknowledged once."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import Frame, Input, Percept
from pipeline.bus.inbox import Inbox
from pipeline.bus.outport import Arrival
from pipeline.testing import header, picture

PIXELS = picture(1, 1, seed=0)


def arrival(seq: int, stream: str = "s", *, nothing: bool = False) -> Arrival:
    head = header(seq, stream=stream)
    return Arrival(head, None if nothing else Frame(header=head, pixels=PIXELS), seq + 1)


class Recorder:
    """An inbox and the outcomes of what went in."""

    def __init__(self, *, lockstep: bool = False, **inputs: Input) -> None:
        self.outcomes: list[tuple[str, str]] = []
        self.inbox = Inbox(
            inputs,
            lambda name, outcome, _: self.outcomes.append((name, outcome)),
            lockstep=lockstep,
        )

    def put(self, name: str, seq: int, **kind: object) -> None:
        self.inbox.offer(name, arrival(seq, **kind), now_ns=0)  # type: ignore[arg-type]

    def take(self, now_ms: float = 0) -> int | None:
        work = self.inbox.take(int(now_ms * 1e6))
        return work.header.seq if work else None


LATEST, EVERY = Input(Frame), Input(Frame, keep="every")


def test_latest_gives_the_newest_and_counts_the_others() -> None:
    recorder = Recorder(frame=LATEST)
    for seq in range(3):
        recorder.put("frame", seq)

    assert recorder.take() == 2
    assert recorder.take() is None
    assert recorder.outcomes == [("frame", "superseded")] * 2


def test_every_gives_all_in_order() -> None:
    recorder = Recorder(frame=EVERY)
    for seq in range(3):
        recorder.put("frame", seq)

    assert [recorder.take() for _ in range(4)] == [0, 1, 2, None]
    assert recorder.outcomes == []


def test_a_tap_that_keeps_every_message_has_room_for_its_depth() -> None:
    recorder = Recorder(frame=Input(Frame, keep="every", depth=3, join=False, tap=True))
    for seq in range(5):
        recorder.put("frame", seq)

    assert [recorder.take() for _ in range(4)] == [2, 3, 4, None]
    assert recorder.outcomes == [("frame", "superseded")] * 2


def test_a_set_waits_for_its_partner_of_the_same_frame() -> None:
    recorder = Recorder(left=LATEST, right=LATEST)
    recorder.put("left", 5)

    assert recorder.take() is None
    recorder.put("right", 5)
    assert recorder.take() == 5


def test_a_partner_that_can_no_longer_come_is_not_waited_for() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("left", 1)
    recorder.put("right", 2)

    assert recorder.outcomes == [("left", "unmatched")]
    recorder.put("left", 2)
    assert recorder.take() == 2


def test_latest_drops_whole_sets() -> None:
    recorder = Recorder(left=LATEST, right=LATEST)
    for seq in (1, 2):
        recorder.put("left", seq)
        recorder.put("right", seq)

    assert recorder.take() == 2
    assert sorted(recorder.outcomes) == [("left", "superseded"), ("right", "superseded")]


def test_none_on_a_required_input_is_answered_with_none() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("left", 1)
    recorder.put("right", 1, nothing=True)

    work = recorder.inbox.take(0)

    assert work is not None
    assert not work.answer
    assert set(work.arrived) == {"left", "right"}


def test_an_optional_input_is_waited_for_until_its_timeout() -> None:
    recorder = Recorder(left=EVERY, right=Input(Frame, keep="every", optional=True, wait_ms=5))
    recorder.put("left", 1)

    assert recorder.take(now_ms=4) is None
    work = recorder.inbox.take(int(6e6))
    assert work is not None
    assert work.messages["right"] is None
    recorder.put("right", 1)
    assert recorder.outcomes == [("right", "unmatched")]


def test_in_lockstep_an_optional_input_is_waited_for_until_it_answers() -> None:
    recorder = Recorder(lockstep=True, left=EVERY, right=Input(Frame, optional=True, wait_ms=5))
    recorder.put("left", 1)

    assert recorder.take(now_ms=1e6) is None
    recorder.put("right", 1, nothing=True)
    assert recorder.take() == 1


def test_an_input_that_does_not_join_is_handled_after_the_set_in_lockstep() -> None:
    recorder = Recorder(lockstep=True, frame=EVERY, beside=Input(Percept, join=False))
    recorder.put("beside", 3)

    assert recorder.take() is None
    recorder.put("frame", 3)
    first, second = recorder.inbox.take(0), recorder.inbox.take(0)
    assert first is not None
    assert second is not None
    assert tuple(first.messages) == ("frame",)
    assert tuple(second.messages) == ("beside",)


def test_a_new_stream_flushes_the_old_and_is_announced() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("left", 9)
    recorder.put("left", 0, stream="t")
    recorder.put("right", 0, stream="t")
    recorder.put("right", 9)  # a straggler of the old stream

    work = recorder.inbox.take(0)

    assert work is not None
    assert work.new_stream
    assert work.header.stream == "t"
    assert recorder.outcomes == [("left", "unmatched"), ("right", "unmatched")]


def test_what_waits_of_an_old_stream_is_not_expected_in_a_new_one() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("left", 9)

    recorder.put("right", 0, stream="t")
    recorder.put("left", 0, stream="t")

    assert recorder.take() == 0
    assert recorder.outcomes == [("left", "unmatched")]


def test_an_input_that_does_not_join_is_counted_when_its_stream_ends() -> None:
    recorder = Recorder(frame=LATEST, beside=Input(Frame, keep="every", join=False))
    recorder.put("beside", 9)

    recorder.put("frame", 0, stream="t")

    assert recorder.take() == 0
    assert recorder.outcomes == [("beside", "unmatched")]
    assert len(recorder.inbox) == 0


def test_a_message_that_comes_twice_is_handled_once_and_both_are_counted() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("left", 5)

    recorder.put("left", 5)
    recorder.put("right", 5)

    assert recorder.take() == 5
    assert recorder.take() is None
    assert recorder.outcomes == [("left", "unmatched")]


def test_in_lockstep_inputs_that_do_not_join_run_where_no_set_can_come() -> None:
    recorder = Recorder(lockstep=True, beside=Input(Frame, join=False))
    recorder.put("beside", 3)

    assert recorder.take() == 3


def test_a_successor_refuses_the_streams_that_had_ended_before_it() -> None:
    before, after = Recorder(frame=LATEST), Recorder(frame=LATEST)
    before.put("frame", 9)
    before.put("frame", 0, stream="t")

    after.inbox.go_on_from(before.inbox.position())
    after.put("frame", 10)

    assert after.take() is None
    assert after.outcomes == [("frame", "unmatched")]


def test_an_input_that_is_rewired_counts_what_waits_of_its_old_output() -> None:
    side = Input(Frame, keep="every", join=False)
    recorder = Recorder(left=EVERY, right=EVERY, beside=side, other=side)
    for name in ("left", "beside", "other"):
        recorder.put(name, 5)

    recorder.inbox.abandon("left")
    recorder.inbox.abandon("beside")

    assert recorder.outcomes == [("left", "unmatched"), ("beside", "unmatched")]
    assert len(recorder.inbox) == 1
    assert recorder.take() == 5


def test_stale_sets_are_dropped_and_counted() -> None:
    recorder = Recorder(frame=Input(Frame, max_age_ms=50))
    recorder.put("frame", 0)  # stamped at 0 ms

    work = recorder.inbox.take(int(60e6))

    assert work is not None
    assert not work.answer
    assert recorder.outcomes == [("frame", "stale")]


@pytest.mark.parametrize("keep", ["latest", "every"])
@given(data=st.data())
def test_every_arrival_is_acknowledged_once_and_memory_is_bounded(
    keep: str, data: st.DataObject
) -> None:
    declared = Input(Frame, keep=keep, depth=4)  # type: ignore[arg-type]
    recorder, bound = Recorder(left=declared, right=declared), 4 if keep == "latest" else 10
    streams = {
        name: sorted(data.draw(st.sets(st.integers(0, 30), max_size=12)))
        for name in ("left", "right")
    }
    order = data.draw(st.permutations([n for n, seqs in streams.items() for _ in seqs]))
    acknowledged: Counter[str] = Counter()
    handled = []
    for name in order:
        recorder.put(name, streams[name].pop(0))
        if data.draw(st.booleans()) and (work := recorder.inbox.take(0)):
            handled.append(work.header.seq)
            acknowledged.update(list(work.arrived))
        assert len(recorder.inbox) <= bound

    while work := recorder.inbox.take(0):
        handled.append(work.header.seq)
        acknowledged.update(list(work.arrived))
    acknowledged.update(name for name, _outcome in recorder.outcomes)

    waiting = Counter(order) - acknowledged
    assert sum(waiting.values()) <= bound
    assert not acknowledged - Counter(order)
    assert handled == sorted(set(handled))


def test_a_histogram_of_nothing_is_zero() -> None:
    from pipeline.bus.histogram import BUCKETS, Histogram

    assert Histogram(np.zeros(BUCKETS, np.uint32)).summary() == {"p50": 0.0, "p99": 0.0}


def test_after_a_loss_an_incomplete_set_is_dropped_when_its_member_is_overdue() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    for seq in range(3):
        recorder.put("right", seq)
    recorder.put("left", 0)

    recorder.inbox.lost("left", now_ns=0)
    recorder.put("right", 3)
    recorder.put("left", 2)

    assert recorder.take(999) == 0
    assert recorder.take(999) == 2
    assert recorder.outcomes == [
        ("right", "unmatched")
    ]  # frame 1: its left member can no longer come
    assert recorder.inbox.due_ns() is not None
    assert recorder.take(1001) is None
    assert len(recorder.inbox) == 1  # frame 3 came after the loss
    assert recorder.inbox.due_ns() is None


def test_a_loss_where_nothing_waits_changes_nothing() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)

    recorder.inbox.lost("left", now_ns=0)
    recorder.put("right", 0)

    assert recorder.take(5000) is None
    assert len(recorder.inbox) == 1


def test_a_set_whose_member_is_lost_is_dropped_after_a_second() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("right", 0)

    recorder.inbox.lost("left", now_ns=0)

    assert recorder.take(999) is None
    assert recorder.outcomes == []
    assert recorder.take(1001) is None
    assert recorder.outcomes == [("right", "unmatched")]


def test_further_losses_do_not_delay_the_drop_of_earlier_sets() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    for seq in range(3):
        recorder.put("right", seq)
        recorder.inbox.lost("left", now_ns=seq * 400_000_000)

    given_up = []
    for now_ms in (999, 1001, 1401, 1801):
        recorder.take(now_ms)
        given_up.append(len(recorder.outcomes))

    assert given_up == [0, 1, 2, 3]


def test_a_loss_in_one_stream_does_not_affect_the_next() -> None:
    recorder = Recorder(left=EVERY, right=EVERY)
    recorder.put("right", 5)
    recorder.inbox.lost("left", now_ns=0)

    recorder.put("right", 0, stream="t")

    assert recorder.take(2000) is None
    assert len(recorder.inbox) == 1
