"""A failure of a successor or of the run during a swap leaves nothing behind."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.protocol.orders import Refused, Result, SwapOrder
from pipeline.run.descendants import tagged
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import assert_accounts_add_up, ended, go, handled, reasons, until, wait_for
from tests.unruly_graphs import unruly_plan


def swap(supervisor: Supervisor, **changes: Any) -> list[Result]:
    """Begin a swap of the unruly part; return the list that its answer is added to."""
    answers: list[Result] = []
    wait_for(supervisor, lambda: handled(supervisor, "after") > 5, 60)
    order = SwapOrder(node="unruly", changes=changes, probation=5)
    supervisor.control.take(order, answers.append)
    return answers


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("exit_in_open", "faulty_samples.py:"),
        ("exit_0", "the new instance ended by exit status 0"),
        ("long_text", ": ValueError: xxxx"),
        ("fork_and_die", "the new instance ended by signal SIGKILL"),
    ],
)
def test_a_successor_that_ends_fails_only_the_swap(tmp_path: Path, kind: str, said: str) -> None:
    answers: list[Result] = []
    note = tmp_path / "pids"

    def during(supervisor: Supervisor) -> None:
        changes = {"kind": kind, "note": str(note), "size": 100_000, "at": 0}
        found = swap(supervisor, **changes)
        wait_for(supervisor, lambda: bool(found), 60)
        answers.extend(found)
        seen = handled(supervisor, "after")
        wait_for(supervisor, lambda: handled(supervisor, "after") > seen + 5, 60)
        supervisor.finish()

    report = go(unruly_plan(tmp_path), 0, during)

    assert said in reasons(answers)[0]
    assert len(reasons(answers)[0]) < 2000
    assert report["restarts"] == {}
    assert_accounts_add_up(report)
    pids = [int(line) for line in note.read_text().split()] if note.exists() else []
    until(lambda: all(ended(pid) for pid in pids))


def test_a_run_that_ends_in_the_middle_of_a_swap_ends_every_process(tmp_path: Path) -> None:
    plan = unruly_plan(tmp_path)
    with Supervisor(plan) as supervisor:
        run_id = supervisor.manager.run_folder.run_id
        supervisor.start()
        answers = swap(supervisor, kind="slow_open")
        managed = supervisor.processes["unruly"]
        wait_for(
            supervisor, lambda: any(c is not managed.handle for c in of(supervisor, "unruly")), 60
        )
        supervisor.asked_to_end = lambda: 1
        supervisor.finish()

    assert answers == [Refused(f"{plan.name}: the run ended before that was done")]
    assert list(tagged(run_id)) == []


def of(supervisor: Supervisor, process: str) -> list[Any]:
    return [handle for handle in supervisor.manager.handles if handle.name == process]
