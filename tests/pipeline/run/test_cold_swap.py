"""Each state of a cold swap and its transitions, forward and back."""

import re
from typing import Any

import pytest

from pipeline.protocol.supervision import Failed, Fits
from pipeline.run import cold_swap
from pipeline.run.cold_swap import ColdState, ColdSwap
from pipeline.run.managed_process import START_S
from pipeline.run.swap_machine import SPARE_S
from tests.pipeline.run.swap_stand_in import StandInHandle, Swapping


def swapping(until: str, **order: Any) -> Swapping:
    """Return a swap that has reached a state."""
    one = Swapping(ColdSwap, **{"probation": 3, **order})
    target = one.target
    assert one.tick() == "CHECKING"
    if until == "CHECKING":
        return one
    target.spare_warms = True
    assert one.tick((target.new, Fits())) == "REWARMING"
    if until == "REWARMING":
        return one
    target.spare_warms = False
    assert one.tick() == "STOPPING"
    if until == "STOPPING":
        return one
    target.old.status = 0
    assert one.tick() == "STARTING"
    if until == "STARTING":
        return one
    working(one).ready = True
    assert one.tick() == "RUNNING"
    if until == "RUNNING":
        return one
    target.account.handled += 1
    assert one.tick() == "PROVING"
    return one


def working(one: Swapping) -> StandInHandle:
    return one.target.working()


def test_a_swap_that_goes_well_passes_every_state_once() -> None:
    one = swapping("PROVING")
    one.now_s += 0.5
    one.target.account.handled += 3

    assert one.tick() == "DONE"
    assert one.target.old.told == ["Stop"]
    assert one.machine.other is None
    assert one.target.did == [
        "refresh_spare", "dismiss", "refresh_spare", "vacate", "forget_settings",
        "start after", "change_plan after",
    ]  # fmt: skip
    assert one.machine.facts == {
        "node": "work", "hot": False,
        "state": "begins anew: it was stopped and started", "gap_ms": 0.0, "proven_frames": 3,
    }  # fmt: skip


def test_spares_that_hang_in_their_imports_are_not_waited_for() -> None:
    one = Swapping(ColdSwap)
    one.target.spare_warms = True
    assert one.tick() == "WARMING"
    assert one.tick(later_s=SPARE_S + 1) == "CHECKING"

    one = swapping("REWARMING")
    assert one.tick(later_s=SPARE_S + 1) == "STOPPING"
    assert one.target.did[-1] == "drop_spare"


def test_what_does_not_fit_is_refused_before_anything_is_stopped() -> None:
    one = swapping("CHECKING")
    one.target.new.status = 1

    assert one.tick() == "CHECKING"  # its last event is received with the next tick
    assert one.tick((one.target.new, Failed("no such setting", True))) == "no such setting"
    assert one.target.old.told == []
    assert not one.machine.owned


def test_a_trial_that_sends_nothing_is_refused() -> None:
    one = swapping("CHECKING")

    said = one.tick(later_s=START_S + 1)

    assert said == "work: it was not checked within 60 s"


def test_a_node_that_does_not_stop_is_killed() -> None:
    one = swapping("STOPPING")

    assert one.machine.owned
    assert one.machine.gone == {1}
    assert one.tick() == "STOPPING"
    assert one.target.old.killed == 0
    assert one.tick(later_s=cold_swap.STOP_S + 0.1) == "STOPPING"
    assert one.target.old.killed == 1
    assert one.tick(later_s=2.0) == "STARTING"  # it hangs in the kernel


def back_again(one: Swapping, why: str) -> None:
    """Assert that the old instance is restarted once the new one has ended."""
    assert one.machine.state is ColdState.STARTING_BACK
    assert one.target.did[-2:] == ["keep_settings", "start before"]
    working(one).ready = True
    assert one.tick() == "RUNNING_BACK"
    one.target.account.handled += 1
    assert one.tick() == f"{why}; the old instance was restarted"
    assert one.target.did[-1] == "change_plan before"
    assert one.machine.facts["rolled_back"]


@pytest.mark.parametrize("state", ["STARTING", "RUNNING", "PROVING"])
def test_a_new_part_that_ends_gives_way_to_the_old_one(state: str) -> None:
    one = swapping(state)
    new = working(one)
    new.status = 1

    assert one.tick() == state
    assert one.tick((new, Failed("by design", False))) == "STARTING_BACK"
    ended = "work: the new instance ended by exit status 1 by design"
    back_again(one, ended if state == "PROVING" else "by design")


def test_a_new_part_that_does_not_get_ready_is_stopped_first() -> None:
    one = swapping("STARTING")
    new = working(one)

    assert one.tick(later_s=START_S + 1) == "STOPPING_BACK"
    assert new.told == ["Stop"]
    new.status = 0
    assert one.tick() == "STARTING_BACK"
    back_again(one, "work: it was not ready within 60 s")


def test_a_new_part_that_is_too_slow_gives_way_to_the_old_one() -> None:
    one = swapping("PROVING", probation=5, budget_ms=10.0)
    one.target.account.histograms["handler"].slow_ms = 11.0
    one.target.account.handled += 5
    new = working(one)
    new.status = None

    assert one.tick() == "STOPPING_BACK"
    new.status = 0
    assert one.tick() == "STARTING_BACK"
    back_again(one, "work: the new instance takes 11.0 ms a frame, expected at most 10.0 ms")


def test_a_new_part_that_cannot_be_started_gives_way_to_the_old_one() -> None:
    one = swapping("STOPPING")
    one.target.old.status, one.target.refuses_to_start = 0, 1

    assert one.tick() == "STARTING_BACK"
    back_again(one, "work: cannot be started")


def test_a_node_that_cannot_be_started_at_all_is_left_to_the_process_manager() -> None:
    one = swapping("STOPPING")
    one.target.old.status, one.target.refuses_to_start = 0, 2

    assert one.tick() == "work: cannot be started"
    one.machine.clear_up(failed=True)
    assert one.target.did[-2:] == ["send_also_to 0", "retry_soon"]
    assert not one.machine.owned


def test_without_frames_the_swap_is_done_after_a_while() -> None:
    one = swapping("RUNNING")

    assert one.tick(later_s=cold_swap.QUIET_S + 1) == "PROVING"
    for _ in range(20):
        assert one.tick(later_s=0.5) == "PROVING"
    assert one.tick(later_s=0.5) == "DONE"
    assert one.machine.facts["proven_frames"] == 0


def test_every_state_stands_in_the_drawing() -> None:
    drawn = set(re.findall(r"[A-Z_]+", cold_swap.__doc__ or ""))

    assert {state.name for state in ColdState} <= drawn
