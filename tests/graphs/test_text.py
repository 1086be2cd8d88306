"""The text graph, in line and as processes."""

from pathlib import Path

import pytest

pytest.importorskip("rapidocr")
pytest.importorskip("PIL")

from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Message, Percept, RoiSchedule
from pipeline.run.inline import InlineRunner

GRAPH = Path(__file__).parents[2] / "graphs" / "text.yaml"
OFF = ("capture.frames=24", "capture.seed=50003")


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
