"""The graph that verifies faint candidates for a ball by a second detector in the ROI."""

from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from pipeline.boxes import covered
from pipeline.cli import commands
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message, RoiFeatures, Scanpath, Truth
from pipeline.run.inline import InlineRunner

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "tracking.yaml"


def test_the_graph_is_checked_without_a_warning() -> None:
    result = CliRunner().invoke(commands, ["check", "tracking"])

    assert result.exit_code == 0, result.output
    assert "warning" not in result.output


def test_a_ball_is_looked_at_until_it_is_verified_and_then_followed() -> None:
    windows: dict[int, Any] = {}
    balls: dict[int, Any] = {}
    last: dict[str, Message] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Frame):  # its pixels are lent
            if output == "capture.roi":
                windows[message.header.seq] = message.window
            return
        last[output.partition(".")[0]] = message
        if isinstance(message, Truth):
            balls[message.header.seq] = message.boxes[message.labels.index("ball")][None]

    plan_of_run = load(GRAPH, Overlay(changes=("capture.seed=50001",), clock="lockstep"))
    with InlineRunner(plan_of_run, watch=watch) as run:
        assert len(list(run.run(45))) == 45

    shown = [covered(balls[k], np.array(windows[k], np.float32))[0] for k in range(20, 45)]
    assert np.mean(shown) > 0.5
    plan, verified = last["policy"], last["verify"]
    assert isinstance(plan, Scanpath)
    assert isinstance(verified, RoiFeatures)
    assert plan.choice[0] in verified.ids
