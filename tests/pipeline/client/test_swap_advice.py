"""A swap asks the new operator's advice: what cannot work beside the others is refused."""

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

from pipeline import SettingsError
from pipeline.client.find import find
from pipeline.contract import SOURCE
from pipeline.protocol.orders import SwapOrder, SwapResult
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import beside, go, plan_of, together
from tests.samples import Pass, WorkSettings

GRAPH = together(
    """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {rate_hz: 40, side_px: 64}
  glance:
    operator: tests.pipeline.client.test_swap_advice:Careful
    inputs: {frame: ticker.roi}
""",
    "ticker",
)


class Careful(Pass):
    """Passes pictures on, no more seldom than the source has pixels on a side."""

    @classmethod
    def advise(cls, settings: WorkSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        side_px = upstream[SOURCE].side_px
        assert upstream["frame"].side_px == side_px
        if settings.every > side_px:
            raise SettingsError(f"every: expected at most {side_px}, got {settings.every}")
        return ["warning: few pictures"] if settings.every > side_px / 2 else ["as it should be"]


def test_a_swap_to_settings_that_the_others_do_not_fit_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plan = plan_of(tmp_path, GRAPH)

    def during(supervisor: Supervisor) -> None:
        def swap(every: int) -> SwapResult:
            order = SwapOrder(node="glance", changes={"every": every}, probation=2)
            found: SwapResult = beside(supervisor, lambda: find(plan.name).swap(order))
            return found

        with pytest.raises(SettingsError, match=r"glance\.every: expected at most 64, got 65"):
            swap(65)
        with caplog.at_level(logging.WARNING, "pipeline.client.advising"):
            assert swap(2).node == "glance"
            assert caplog.messages == []
            assert swap(33).node == "glance"
        assert caplog.messages == ["glance: few pictures"]
        supervisor.finish()

    report = go(plan, 0, during)

    assert not report["failure"]
