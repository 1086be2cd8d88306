"""The text graph, in line and as processes."""

from pathlib import Path

import pytest

pytest.importorskip("rapidocr")
pytest.importorskip("PIL")

from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Message, Percept, RoiSchedule
from pipeline.protocol.orders import Result
from pipeline.run.inline import InlineRunner
from pipeline.run.supervisor import Supervisor
from tests.pipeline.run.test_swap import order
from tests.sample_graphs import go, handled, plan_of, reasons, wait_for

GRAPH = Path(__file__).parents[2] / "graphs" / "text.yaml"
OFF = ("capture.frames=24", "capture.seed=50003")


@pytest.mark.lengthy
def test_texts_are_read_and_the_roi_moves_to_them() -> None:
    plan = load(GRAPH, Overlay(changes=OFF, clock="lockstep"))
    percepts: list[Percept] = []
    windows: set[tuple[int, ...]] = set()

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Percept):
            percepts.append(message)
        if isinstance(message, RoiSchedule):
            windows.update(tuple(row) for row in message.windows.tolist())

    with InlineRunner(plan, watch=watch) as runner:
        frames = list(runner.run())
        summary = runner.operator("score").summary()

    assert len(frames) == 24
    assert len(percepts) == 24
    assert any(percept.texts for percept in percepts)
    assert len(windows) > 3
    assert summary["read"] >= 1
    assert summary["legible"] >= summary["read"]


READERS = """\
nodes:
  capture:
    operator: operators.capture:Capture
    settings:
      sensor: drivers.simulated:SimulatedSensor
      options:
        {scene: road, strategy: round_robin, context_scale: 0.25, roi_area: 0.25, budget: 0.3125,
         rate_hz: 4, seed: 50003}
  reader:
    operator: operators.reader:Reader
    inputs: {context: capture.context, roi: capture.roi}
"""


@pytest.mark.lengthy
def test_another_reader_takes_over_while_the_graph_runs_and_knows_what_was_read(
    tmp_path: Path,
) -> None:
    results: list[Result] = []
    deaf = order("reader", operator="operators.reader:OnnxReader", changes={"least_score": 1.0})

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "reader") > 6)
        supervisor.control.take(deaf, results.append)
        wait_for(supervisor, lambda: bool(results))
        supervisor.finish()

    report = go(plan_of(tmp_path, READERS), 0, during)

    assert reasons(results) == [""]
    assert report["restarts"] == {}
    assert report["summaries"]["reader"]["readings"] == 0  # the successor has read nothing itself
    assert report["summaries"]["reader"]["texts"] > 0
