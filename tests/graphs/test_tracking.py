"""The tracking graph verifies the ball and keeps it in view, in line and as processes."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from pipeline.boxes import covered
from pipeline.cli import commands
from pipeline.cli.running import status_line
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message, RoiFeatures, Scanpath, Truth
from pipeline.protocol.orders import Result, SwapOrder
from pipeline.run.inline import InlineRunner
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import handled, reasons, wait_for
from tests.shared_data import Footage

ROOT = Path(__file__).resolve().parents[2]
GRAPH = ROOT / "graphs" / "tracking.yaml"


def run(tmp_path: Path, *words: str) -> dict[str, Any]:
    report = tmp_path / "report.json"
    command = [sys.executable, "-m", "pipeline.cli", "run", str(GRAPH), "--report", str(report)]
    done = subprocess.run(
        [*command, *words], capture_output=True, text=True, cwd=ROOT, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(report.read_text())
    return found


@pytest.mark.lengthy
def test_in_line_and_as_processes_the_sensor_gets_the_same_commands(tmp_path: Path) -> None:
    inline = run(tmp_path, "--inline", "--frames", "15")
    processes = run(tmp_path, "--clock", "lockstep", "--frames", "15")

    assert inline["schedule_sha256"] == processes["schedule_sha256"]
    assert inline["roi_coverage"] == processes["roi_coverage"]
    for edge in processes["edges"]:
        assert edge["offered"] == edge["delivered"], edge


def test_the_graph_is_checked_without_a_warning() -> None:
    result = CliRunner().invoke(commands, ["check", "tracking"])

    assert result.exit_code == 0, result.output
    assert "warning" not in result.output


@pytest.mark.lengthy
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


@pytest.fixture(scope="module")
def tracking() -> Iterator[Supervisor]:
    """Run the graph as processes; tests may replace nodes, but none of them may die."""
    with Supervisor(load(GRAPH)) as supervisor:
        supervisor.start()
        yield supervisor
        assert (supervisor.failure, supervisor.restarts) == ("", {})


def test_the_status_line_of_a_running_graph_shows_its_overlap_with_the_truth(
    tracking: Supervisor,
) -> None:
    def overlap() -> float:
        name, _, figure = tracking.reports.headlines.get("score", "").partition(" ")
        return float(figure) if name == "IoU" else 0.0

    wait_for(tracking, lambda: overlap() > 0.2)  # it follows what the policy shows

    assert tracking.reports.headlines["score"] in status_line(tracking, 1.0)


@pytest.mark.lengthy
def test_a_model_file_is_swapped_like_any_setting_and_a_missing_one_is_refused(
    tracking: Supervisor, tmp_path: Path
) -> None:
    shipped = ROOT / "operators" / "saliency" / "detector_int8.onnx"
    other = shutil.copy(shipped, tmp_path / "other.onnx")
    answers: list[Result] = []
    wait_for(tracking, lambda: handled(tracking, "saliency") > 3, 60)

    for weights in (other, tmp_path / "none.onnx"):
        order = SwapOrder(node="saliency", changes={"weights": str(weights)}, probation=5)
        wanted = len(answers) + 1
        tracking.control.take(order, answers.append)
        wait_for(tracking, partial(lambda count: len(answers) >= count, wanted), 60)
    before = handled(tracking, "saliency")
    wait_for(tracking, lambda: handled(tracking, "saliency") > before + 5, 60)

    first, second = reasons(answers)
    assert first == ""
    assert "no such weights" in second


@pytest.mark.footage
def test_the_graph_runs_on_real_footage_in_real_time(tmp_path: Path, footage: Footage) -> None:
    snmot = footage.data("soccernet/SNMOT-116a")

    report = run(
        tmp_path, "--source", "graphs/sources/soccernet.yaml", "--set", f"capture.path={snmot}",
        "--frames", "40",
    )  # fmt: skip

    assert report["frames"]["exposed"] == 40
    assert report["loop"]["commands"] > 5  # the loop closes; how often is the machine's affair
    for edge in report["edges"]:
        if edge["keep"] == "every":
            # on a busy machine `saliency` passes over a frame, whose picture `kits` then has alone;
            # how often is the machine's affair, as long as commands come
            edge["dropped"].pop("unmatched", 0)
            assert edge["dropped"] == {}, edge
