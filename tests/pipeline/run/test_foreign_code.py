"""Operators that an order names are imported by node processes, never by the supervisor.

The modules here lie in a folder that node processes alone look into: a supervisor that imported one
would refuse the order.
"""

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.graph.plan import Plan
from pipeline.protocol.orders import Order, PlanOrder, Refused, Result, SwapOrder, TopologyResult
from pipeline.run.loaded_graph import account_of
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    LOSSLESS,
    apart,
    ended,
    handled,
    plan_of,
    reasons,
    swapped,
    until,
    wait_for,
    wait_for_progress,
)

GOOD = "from tests.samples import Count as Part, PassEvery as Other, Ticker as Clock\n"
BAD = {
    "exits": ("import os\nos._exit(0)\n", "ended by exit status 0"),
    "crashes": ("import ctypes\nctypes.string_at(0)\n", "ended by signal SIGSEGV"),
    "raises": ("1 / 0\n", "{module}.py:1: ZeroDivisionError"),
    "leaves": ("raise SystemExit(0)\n", "{module}.py:1: it exits: 0"),
    "is no operator": ("Part = 5\n", "{module}:Part: expected an Operator, got 5"),
    "has another input": ("from tests.samples import Steer as Part\n", "second: no input frame"),
}


def find_in(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Have processes that are started from now on look for modules in a folder."""
    words = [str(folder), *filter(None, [os.environ.get("PYTHONPATH", str(Path.cwd()))])]
    patch.setenv("PYTHONPATH", os.pathsep.join(words))


@pytest.fixture
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of a module that node processes find and this process does not."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    find_in(folder, monkeypatch)
    return folder / "theirs.py"


def added(plan: Plan, operator: str = "theirs:Part") -> Plan:
    """Return the plan with a second reader of `work`."""
    node, edge = plan.node("count"), plan.inputs("count")["frame"]
    return replace(
        plan,
        nodes=(*plan.nodes, replace(node, name="second", group="", operator=operator, index=7)),
        edges=(*plan.edges, replace(edge, target="second", index=7)),
    )


def done(supervisor: Supervisor, order: Order) -> Result:
    results: list[Result] = []
    supervisor.control.take(order, results.append)
    wait_for(supervisor, lambda: results)
    return results[0]


@pytest.mark.lengthy
def test_what_is_added_and_swapped_in_is_never_imported_by_the_supervisor(
    tmp_path: Path, theirs: Path
) -> None:
    theirs.write_text(GOOD)
    with Supervisor(plan_of(tmp_path, apart(LOSSLESS))) as supervisor:
        supervisor.start()

        told = done(supervisor, PlanOrder(plan=added(supervisor.plan), revision=0))
        assert isinstance(told, TopologyResult), told
        assert told.added == ["second"]
        for node, part in (("work", "Other"), ("ticker", "Clock"), ("second", "Part")):
            order = SwapOrder(node=node, operator=f"theirs:{part}", probation=3)
            assert swapped(done(supervisor, order)).node == node
        wait_for_progress(supervisor, "second")
        supervisor.finish()
        supervisor.stop()
        report = account_of(supervisor, 1.0)

    assert supervisor.failure == ""
    assert report["rate"]["frames"] > 0
    assert "theirs" not in sys.modules


def test_an_addition_whose_import_never_ends_delays_neither_frames_nor_the_end(
    tmp_path: Path, theirs: Path
) -> None:
    note = tmp_path / "pid"
    theirs.write_text(f"import os, time\nopen({str(note)!r}, 'w').write(f'{{os.getpid()}}\\n')\n"
                      "time.sleep(1000)\n")  # fmt: skip
    results: list[Result] = []
    with Supervisor(plan_of(tmp_path, LOSSLESS)) as supervisor:
        supervisor.start()
        order = PlanOrder(plan=added(supervisor.plan), revision=0)
        supervisor.control.take(order, results.append)
        wait_for(supervisor, lambda: note.exists() and note.read_text().endswith("\n"))

        wait_for_progress(supervisor, "count")
        supervisor.asked_to_end = lambda: 1
        supervisor.finish()
        supervisor.stop()

        until(lambda: ended(int(note.read_text())), 10)
    assert isinstance(results[0], Refused)
    assert "the run ended before that was done" in results[0].reason
    assert handled(supervisor, "count") > 0


@pytest.mark.lengthy
def test_an_edited_file_of_code_that_nodes_alone_have_imported_is_imported_anew(
    tmp_path: Path, theirs: Path
) -> None:
    theirs.write_text(GOOD)
    with Supervisor(plan_of(tmp_path, apart(LOSSLESS))) as supervisor:
        supervisor.start()
        first = SwapOrder(node="count", operator="theirs:Part", probation=3)
        swapped(done(supervisor, first))
        spare = supervisor.manager.spare
        wait_for(supervisor, lambda: spare.process_id and not spare.warming)
        theirs.write_text("print('as it is now')\n" + GOOD)
        moment_s = theirs.stat().st_mtime + 5
        os.utime(theirs, (moment_s, moment_s))

        stale = spare.process_id
        swapped(done(supervisor, first))

        assert supervisor.pid("count") != stale


@pytest.fixture(scope="module")
def breaking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Supervisor]:
    """Run a graph whose node processes find a module `broken_N` for each of `BAD`."""
    folder = tmp_path_factory.mktemp("breaking")
    for number, (text, _said) in enumerate(BAD.values()):
        (folder / f"broken_{number}.py").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        find_in(folder, patch)
        with Supervisor(plan_of(folder, LOSSLESS)) as supervisor:
            supervisor.start()
            yield supervisor
            assert (supervisor.failure, supervisor.restarts) == ("", {})


@pytest.mark.parametrize("kind", BAD)
def test_an_addition_that_breaks_while_it_is_imported_is_refused_and_the_graph_goes_on(
    breaking: Supervisor, kind: str
) -> None:
    module, said = f"broken_{list(BAD).index(kind)}", BAD[kind][1]
    before = breaking.plan

    told = done(breaking, PlanOrder(plan=added(breaking.plan, f"{module}:Part"), revision=0))

    (why,) = reasons([told])
    assert said.format(module=module) in why
    assert f"{module}:Part" in why or "second" in why
    assert "\n" not in why
    assert (breaking.failure, breaking.restarts) == ("", {})
    assert "second" not in breaking.processes
    assert breaking.plan == before
    wait_for_progress(breaking, "count")
