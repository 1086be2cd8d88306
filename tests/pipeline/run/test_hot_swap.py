"""Each state of a hot swap and its transitions, forward and back."""

import re
from typing import Any

import pytest

from pipeline.protocol.orders import ShadowReport
from pipeline.protocol.supervision import (
    Answered,
    CutMade,
    CutRefused,
    Event,
    Failed,
    Resumed,
    Shadowed,
    Standing,
    TakenOver,
)
from pipeline.run import hot_swap
from pipeline.run.hot_swap import HotState, HotSwap
from pipeline.run.managed_process import START_S
from pipeline.run.swap_machine import SPARE_S
from tests.pipeline.run.swap_stand_in import Swapping

STANDING = Standing("work", {"frame": 3})
TAKEN = TakenOver(node="work", seq=9, gap_ms=0.5, state="none", forgotten=[])
ANSWERED = Answered("work", {"frame": 0}, 2.0)


def swapping(until: str = "", **order: Any) -> Swapping:
    """Return a swap that has reached a state."""
    one = Swapping(HotSwap, **{"probation": 3, **order})
    target = one.target
    steps: list[tuple[str, Event | None]] = [
        ("LOADING", None), ("CONNECTING", None), ("CUTTING", STANDING), ("TAKING_OVER", None),
        ("PROVING", TAKEN), ("ANSWERING", None), ("LEAVING", ANSWERED),
    ]  # fmt: skip
    for state, event in steps:
        if state == "CONNECTING":
            target.new.ready = True
        if state == "ANSWERING":
            target.account.handled += 3
        of = (target.old, CutMade("work", 9)) if state == "TAKING_OVER" else (target.new, event)
        assert one.tick(*([of] if of[1] else [])) == state  # type: ignore[list-item]
        if state == until:
            break
    return one


def test_a_swap_that_goes_well_passes_every_state_once() -> None:
    one = swapping("LEAVING")
    one.target.old.status = 0

    assert one.tick() == "DONE"
    assert one.target.old.told == ["Cut", "Stop"]
    assert one.target.new.told == ["Confirm"]
    assert one.target.did == ["refresh_spare", "send_also_to 2", "switch to after", "fence 2"]
    assert one.machine.facts == {
        "node": "work", "hot": True,
        "ready_seq": 7, "seq": 9, "gap_ms": 0.5, "state": "none", "forgotten": [],
        "proven_frames": 3, "left_out": {"frame": 0}, "answered_ms": 2.0,
    }  # fmt: skip


def test_a_spare_that_hangs_in_its_imports_is_not_waited_for() -> None:
    one = Swapping(HotSwap)
    one.target.spare_warms = True

    assert one.tick() == "WARMING"
    assert one.tick(later_s=SPARE_S + 1) == "LOADING"
    assert "drop_spare" in one.target.did


def test_a_shadow_run_comes_before_the_cut() -> None:
    one = swapping("CONNECTING", shadow=5)
    report = ShadowReport(frames=5, identical=5)

    assert one.tick((one.target.new, STANDING)) == "SHADOWING"
    assert one.tick((one.target.new, Shadowed("work", report))) == "CUTTING"
    assert one.machine.facts["shadow"] == report
    assert one.target.old.told == ["Cut", "Cut"]


@pytest.mark.parametrize(
    ("state", "limit_s", "said"),
    [
        ("LOADING", START_S, "work: it was not ready within 60 s"),
        ("CONNECTING", hot_swap.CONNECT_S, "work: its inputs got no handshake within 10 s"),
    ],
)
def test_a_successor_that_does_not_get_ready_in_time_is_refused(
    state: str, limit_s: float, said: str
) -> None:
    one = swapping(state)

    assert one.tick(later_s=limit_s - 1) == state
    assert one.tick(later_s=2) == said


@pytest.mark.parametrize("state", ["LOADING", "CONNECTING"])
def test_a_predecessor_that_ends_meanwhile_ends_the_swap(state: str) -> None:
    one = swapping(state)
    one.target.old.status = -9

    assert one.tick() == "work: it ended meanwhile and starts again; try again"
    assert not one.machine.owned


@pytest.mark.parametrize("state", ["LOADING", "CONNECTING"])
def test_a_successor_that_ends_is_refused_with_the_reason_that_it_sent(state: str) -> None:
    one = swapping(state)
    one.target.new.status = 1

    assert one.tick() == state  # its last event is received with the next tick
    assert one.tick((one.target.new, Failed("it does not fit", True))) == "it does not fit"


def test_a_predecessor_that_cannot_stop_works_on() -> None:
    one = swapping("CUTTING")

    assert one.machine.owned
    assert one.tick((one.target.old, CutRefused("work", "no state"))) == "work: no state"
    one.machine.clear_up(failed=True)
    assert not one.machine.owned
    assert one.target.old.told == ["Cut", "Uncut"]


def test_a_cut_that_does_not_come_is_taken_back_and_may_cross_that_order() -> None:
    for crosses in (False, True):
        one = swapping("CUTTING")
        assert one.tick(later_s=hot_swap.CUT_S + 1) == "TAKING_BACK"
        assert one.target.old.told == ["Cut", "Uncut"]
        if crosses:
            assert one.tick((one.target.old, CutMade("work", 9))) == "TAKING_OVER"
        else:
            said = one.tick(later_s=hot_swap.UNCUT_S + 0.1)
            assert said == "work: it did not reach a frame for the cut"
            assert not one.machine.owned


def test_the_last_event_of_a_predecessor_that_dies_at_the_cut_counts() -> None:
    one = swapping("CUTTING")
    one.target.old.status = 0

    assert one.tick() == "TAKING_BACK"
    assert one.tick((one.target.old, CutMade("work", 9))) == "TAKING_OVER"


def rolled_back(one: Swapping, why: str) -> None:
    """Assert that the old instance continues once the successor has ended or was killed."""
    assert one.target.new.killed == 1
    if one.target.new.status is None:
        assert one.machine.state is HotState.KILLING
        one.target.new.status = -9
        one.tick()
    assert one.machine.state is HotState.RESUMING
    assert one.machine.other is None
    assert one.target.old.told[-1] == "Resume"
    assert one.tick((one.target.old, Resumed("work"))) == f"{why}; the old instance continues"
    assert one.target.did[-3:] == ["back to before", "read_by 3", "fence 3"]
    assert one.machine.facts["rolled_back"]


@pytest.mark.parametrize("state", ["TAKING_OVER", "PROVING", "ANSWERING"])
def test_a_successor_that_ends_is_rolled_back(state: str) -> None:
    one = swapping(state)
    one.target.new.status = 1

    one.tick()
    assert one.tick((one.target.new, Failed("by design", False))) == "RESUMING"
    ended = "work: the new instance ended by exit status 1 by design"
    rolled_back(one, ended if state == "PROVING" else "by design")


def test_a_successor_that_does_not_take_over_is_rolled_back() -> None:
    one = swapping("TAKING_OVER")

    assert one.tick(later_s=hot_swap.ANSWER_S + 1) == "KILLING"
    rolled_back(one, "work: it did not take over within 5 s")


def test_a_setting_that_was_changed_meanwhile_is_not_lost() -> None:
    one = swapping("TAKING_OVER")
    one.target.told = True

    assert one.tick((one.target.new, TAKEN)) == "KILLING"
    rolled_back(one, "work: its settings were changed meanwhile, try again")


def test_a_successor_that_is_too_slow_is_rolled_back() -> None:
    one = swapping("PROVING", probation=5, budget_ms=10.0)
    one.target.account.histograms["handler"].slow_ms = 11.0
    one.target.account.handled += 5

    assert one.tick() == "KILLING"
    rolled_back(one, "work: the new instance takes 11.0 ms a frame, expected at most 10.0 ms")


@pytest.mark.parametrize(("before_ms", "budget_ms"), [(1.0, 20.0), (10.0, 30.0)])
def test_without_a_budget_a_successor_may_take_three_times_as_long_or_20_ms(
    before_ms: float, budget_ms: float
) -> None:
    one = swapping("TAKING_OVER", probation=5)
    times = one.target.account.histograms["handler"]
    times.before_ms = before_ms
    assert one.tick((one.target.new, TAKEN)) == "PROVING"

    times.slow_ms = budget_ms
    one.target.account.handled += 4
    assert one.tick() == "PROVING"
    times.slow_ms = budget_ms + 1
    one.target.account.handled += 1

    assert one.tick() == "KILLING"
    said = f"takes {budget_ms + 1} ms a frame, expected at most {budget_ms} ms"
    rolled_back(one, f"work: the new instance {said}")


def test_a_successor_that_hangs_is_rolled_back_and_one_without_work_is_not() -> None:
    for waits in (True, False):
        one = swapping("PROVING")
        one.target.messages_wait = waits
        for _ in range(4):
            assert one.tick(later_s=0.5) == "PROVING"
        assert one.tick(later_s=0.5) == ("KILLING" if waits else "PROVING")


def test_without_frames_probation_ends_and_no_answer_is_awaited() -> None:
    one = swapping("PROVING")
    for _ in range(20):
        assert one.tick(later_s=0.5) == "PROVING"

    assert one.tick(later_s=0.5) == "LEAVING"
    assert one.machine.facts["proven_frames"] == 0


def test_an_answer_that_does_not_come_fails_no_swap() -> None:
    one = swapping("ANSWERING")

    assert one.tick() == "ANSWERING"
    assert one.tick(later_s=hot_swap.ANSWER_S + 1) == "LEAVING"
    assert "answered_ms" not in one.machine.facts


def test_what_the_predecessor_sent_arrives_before_it_is_fenced_off() -> None:
    one = swapping("ANSWERING")
    one.target.has_arrived = False

    assert one.tick((one.target.new, ANSWERED)) == "DRAINING"
    assert "fence 2" not in one.target.did
    assert one.tick(later_s=hot_swap.DRAIN_S + 1) == "LEAVING"  # a reader that hangs
    assert "fence 2" in one.target.did


def test_a_predecessor_that_does_not_leave_is_not_waited_for() -> None:
    one = swapping("LEAVING")

    assert one.tick() == "LEAVING"
    assert one.tick(later_s=hot_swap.ANSWER_S + 1) == "DONE"
    assert one.machine.other is one.target.old  # to be dismissed


def test_a_predecessor_that_does_not_resume_is_an_error() -> None:
    one = swapping("TAKING_OVER")
    one.tick(later_s=hot_swap.ANSWER_S + 1)
    one.target.new.status = -9
    one.tick()

    said = one.tick(later_s=hot_swap.ANSWER_S + 1)

    assert said == "work: the old instance did not resume within 5 s"


def test_every_state_stands_in_the_drawing() -> None:
    assert {state.name for state in HotState} <= set(re.findall(r"[A-Z_]+", hot_swap.__doc__ or ""))
