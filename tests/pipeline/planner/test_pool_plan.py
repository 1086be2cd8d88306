"""Memory of the pools: against files of real pools, against a machine that is too small."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.bus.pool import DONE, PoolWriter
from pipeline.forecast import Forecast, pictures
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.planner.machine import Machine
from pipeline.planner.pool_plan import PoolPlan, doubted, pool_plan, refused
from pipeline.run.memory_folder import MemoryFolder
from tests.sample_graphs import CHAIN

GIB = 1 << 30
LARGE = Machine(
    cores=4,
    shared_bytes=GIB,
    shared_free_bytes=GIB,
    memory_bytes=4 * GIB,
    memory_free_bytes=2 * GIB,
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("graph") / "graph.yaml"
    path.write_text(f"name: pools\n{CHAIN}")
    return load(path)


def told(plan: Plan, side_px: int) -> dict[str, Forecast]:
    stream = pictures((side_px, side_px), "rgb8", 20)
    ticker = Forecast(streams={"context": stream, "roi": stream})
    return {node.name: ticker if node.name == "ticker" else Forecast() for node in plan.nodes}


@settings(max_examples=20)
@given(side_px=st.integers(1, 400))
def test_a_pool_takes_what_its_file_takes(plan: Plan, side_px: int) -> None:
    nbytes = 3 * side_px * side_px
    (row,) = (r for r in pool_plan(plan, told(plan, side_px)).rows if r.output == "ticker.roi")

    folder = MemoryFolder.claim()
    try:
        if row.pool_bytes:
            PoolWriter(folder, "ticker.roi", row.slots, lambda _ordinal: DONE).lease(nbytes)
        made = folder.pool_bytes()
    finally:
        folder.empty()

    assert made == ({"ticker.roi": row.pool_bytes} if row.pool_bytes else {})
    assert bool(row.pool_bytes) == (nbytes > 8192)


def test_an_output_that_nothing_reads_has_no_pool(plan: Plan) -> None:
    outputs = {row.output for row in pool_plan(plan, told(plan, 100)).rows}

    assert outputs == {"ticker.roi"}


def test_a_profile_tells_what_the_settings_do_not(plan: Plan) -> None:
    nothing = {node.name: Forecast() for node in plan.nodes}

    unknown = pool_plan(plan, nothing)
    recorded = pool_plan(plan, nothing, {"ticker.roi": 123_456})

    assert [row.pool_bytes for row in unknown.rows] == [None]
    assert [(row.pool_bytes, row.recorded) for row in recorded.rows] == [(123_456, True)]
    assert recorded.total_bytes - unknown.total_bytes == 123_456


@pytest.mark.parametrize(
    ("machine", "where"),
    [
        (replace(LARGE, shared_bytes=20_000_000), "/dev/shm"),
        (replace(LARGE, memory_bytes=20_000_000), "memory"),
    ],
)
def test_pools_that_the_machine_has_no_room_for_are_refused(
    plan: Plan, machine: Machine, where: str
) -> None:
    found = pool_plan(plan, told(plan, 1000))

    (said,) = refused(found, machine)
    assert said.startswith(f"pools: expected up to 20 MB of {where}, got ")
    assert said.endswith("; the largest is ticker.roi, 216 MB")


def test_room_that_is_in_use_now_is_a_warning(plan: Plan) -> None:
    found = pool_plan(plan, told(plan, 1000))
    crowded = replace(LARGE, shared_free_bytes=1_000_000)

    assert not list(refused(found, crowded))
    assert "1.0 of the 1074 MB of /dev/shm are free now" in next(doubted(found, crowded))


def test_memory_of_other_hosts_is_not_judged_here(plan: Plan) -> None:
    nodes = tuple(replace(node, host="far") for node in plan.nodes)
    found = pool_plan(replace(plan, nodes=nodes, hosts=("far",)), told(plan, 1000))

    assert {row.host for row in found.rows} == {"far"}
    assert not list(refused(found, replace(LARGE, shared_bytes=1)))


def test_a_machine_that_does_not_tell_its_memory_refuses_nothing(plan: Plan) -> None:
    found: PoolPlan = pool_plan(plan, told(plan, 1000))
    silent = replace(LARGE, shared_bytes=0, shared_free_bytes=0)

    assert not [*refused(found, silent), *doubted(found, silent)]
