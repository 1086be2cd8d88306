"""A part is replaced while its graph runs: nothing is lost, nothing comes twice."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.supervisor import Supervisor
from pipeline.swap import SwapOrder
from tests.pipeline.test_runtime import (
    assert_accounts_add_up,
    edge,
    go,
    handled,
    plan_of,
    wait_for,
)

CHAIN = """\
nodes:
  ticker:
    operator: tests.toys:Ticker
    settings: {rate_hz: 60, side_px: 120}
  work:
    operator: tests.toys:PassEvery
    inputs: {frame: {from: ticker.context, depth: 60}}
  count:
    operator: tests.toys:Count
    inputs: {frame: {from: work, depth: 60}}
"""


def swapping(results: list[dict[str, Any]], *orders: SwapOrder) -> Callable[[Supervisor], None]:
    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        for count, order in enumerate(orders, len(results) + 1):
            supervisor.desk.take(order, lambda answer: results.append(json.loads(answer)))
            wait_for(supervisor, partial(lambda wanted: len(results) >= wanted, count), 30)

    return during


def test_no_frame_is_lost_and_none_comes_twice(tmp_path: Path) -> None:
    results: list[dict[str, Any]] = []
    orders = [SwapOrder(node="work", probation=5) for _ in range(3)]

    report = go(plan_of(tmp_path, CHAIN), 400, swapping(results, *orders))

    assert [r["refused"] for r in results] == ["", "", ""]
    assert report["summaries"]["count"] == {"seen": list(range(400)), "torn": 0}
    assert_accounts_add_up(report)
    assert edge(report, "work.frame")["delivered"] == 400
    assert edge(report, "count.frame")["delivered"] == 400
    assert report["restarts"] == {}
    assert max(r["gap_ms"] for r in results) < 500
