"""CPU at the asked rate: scaled from a recorded run, with what that run dropped."""

from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.planner.cpu_plan import cpu_plan, doubted, refused, shares_of
from pipeline.planner.machine import Machine
from pipeline.run.recorded_run import (
    ProcessProfile,
    Profile,
    RecordedEdge,
    RecordedRate,
    RecordedRun,
    RecordedStage,
    Spread,
    digest,
)
from tests.sample_graphs import CHAIN

TWO = Machine(cores=2, shared_bytes=0, shared_free_bytes=0, memory_bytes=0, memory_free_bytes=0)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("graph") / "graph.yaml"
    path.write_text(f"name: busy\n{CHAIN}")
    return load(path)


def run(plan: Plan, *, cores: float = 0.4, handled: int = 200) -> RecordedRun:
    """Return 10 s at 20 Hz in which `count` used `cores`, and the ticker 0.1."""
    used = {"ticker": 0.1, "count": cores}
    return RecordedRun(
        graph=plan.name, clock="realtime", duration_s=10.0,
        edges=(RecordedEdge(to="count.frame", offered=200),),
        stages=(RecordedStage(node="count", handled=handled),),
        rate=RecordedRate(frames=200, asked_hz=20.0, achieved_hz=20.0),
        profile=Profile(
            cores=2.0, pools={}, settings={n.name: digest(n) for n in plan.nodes},
            processes={n: ProcessProfile(nodes=(n,), cores=c) for n, c in used.items()},
        ),
    )  # fmt: skip


def test_the_need_is_that_of_the_recorded_run_at_its_own_rate(plan: Plan) -> None:
    found = cpu_plan(plan, run(plan), 0.0)

    assert [(row.process, round(row.ms_per_frame, 6)) for row in found.rows] == [
        ("count", 20.0), ("ticker", 5.0),
    ]  # fmt: skip
    assert (found.rate_hz, found.cores) == (20.0, pytest.approx(0.5))
    assert (found.missing, found.changed) == (("glance",), ())


@given(rate_hz=st.floats(0.1, 1000))
def test_the_need_grows_with_the_rate(plan: Plan, rate_hz: float) -> None:
    found = cpu_plan(plan, run(plan), rate_hz)

    assert found.cores == pytest.approx(0.5 * rate_hz / 20)
    assert bool(list(refused(found, TWO))) == (found.cores > 2)


def test_more_cores_than_there_are_is_refused_with_the_rate_that_would_fit(plan: Plan) -> None:
    (said,) = refused(cpu_plan(plan, run(plan), 120.0), TWO)

    assert said == (
        "CPU: expected up to 2 cores, got 3.00 at 120 Hz, most of it count 2.40, ticker 0.60; at "
        "most 80 Hz"
    )


def test_cores_that_are_nearly_all_in_use_are_a_warning(plan: Plan) -> None:
    found = cpu_plan(plan, run(plan), 72.0)

    assert not list(refused(found, TWO))
    assert list(doubted(found, TWO)) == ["CPU: 1.80 of 2 cores at 72 Hz leave little for peaks"]


def test_what_a_node_dropped_is_counted_as_if_it_had_handled_it(plan: Plan) -> None:
    found = cpu_plan(plan, run(plan, handled=50), 20.0)

    assert found.rows[0].cores == pytest.approx(1.6)


def test_settings_that_have_changed_since_are_named(plan: Plan) -> None:
    faster = replace(plan.node("ticker"), settings={"rate_hz": 50})
    changed = replace(plan, nodes=(faster, *plan.nodes[1:]))

    assert cpu_plan(changed, run(plan), 50.0).changed == ("ticker",)


def test_in_lockstep_there_is_no_rate_to_hold(plan: Plan) -> None:
    found = cpu_plan(replace(plan, clock="lockstep"), run(plan), 1000.0)

    assert (found.rate_hz, found.cores) == (0.0, None)
    assert not [*refused(found, TWO), *doubted(found, TWO)]


def test_a_process_of_nodes_that_the_graph_no_longer_has_does_not_count(plan: Plan) -> None:
    recorded = run(plan)
    assert recorded.profile is not None
    gone = ProcessProfile(nodes=("gone",), cores=9.0)
    processes = {**recorded.profile.processes, "gone": gone}
    profile = msgspec.structs.replace(recorded.profile, processes=processes)

    found = cpu_plan(plan, msgspec.structs.replace(recorded, profile=profile), 20.0)

    assert "gone" not in {row.process for row in found.rows}


def test_a_run_that_fell_short_of_its_rate_is_a_doubtful_profile(plan: Plan) -> None:
    recorded = run(plan)
    slow = RecordedRate(frames=80, asked_hz=20.0, achieved_hz=8.0)

    found = cpu_plan(plan, msgspec.structs.replace(recorded, rate=slow), 20.0)

    assert next(doubted(found, TWO)).startswith("profile: its run fell short of its rate, 8 of 20")


def test_a_group_is_split_by_the_time_of_its_handlers() -> None:
    stages = (
        RecordedStage(node="a", handled=100, latency_ms=Spread(p50=3.0, p99=9.0)),
        RecordedStage(node="b", handled=50, latency_ms=Spread(p50=2.0, p99=2.0)),
        RecordedStage(node="c", handled=50),
    )
    run = RecordedRun(graph="g", clock="realtime", duration_s=1.0, edges=(), stages=stages)

    assert shares_of(run, ("a", "b")) == (0.75, 0.25)
    assert shares_of(run, ("a", "c")) == ()
    assert shares_of(run, ("a",)) == ()
