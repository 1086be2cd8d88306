"""The graph of the robot: targets and windows reach it, and nothing is above the pixel budget."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from drivers.robot import Joints
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Message, Percept, Truth
from pipeline.run.inline import InlineRunner
from tests.conftest import ROOT

GRAPH = ROOT / "graphs" / "manipulation.yaml"

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
)


@needs_robot
def test_the_loop_closes_over_arms_and_sensor(tmp_path: Path) -> None:
    seen: dict[str, list[Message]] = {}

    def watch(output: str, message: Message) -> None:
        seen.setdefault(output, []).append(message)

    plan = load(GRAPH, Overlay(changes=("robot.seed=80004", "robot.frames=12")))
    with InlineRunner(plan, watch=watch) as runner:
        assert list(runner.run()) == list(range(12))
        summary = runner.operator("robot").summary()

    assert summary["pixels"]["used"] <= 1 / 16
    assert summary["commands"]["accepted"] > 0
    assert summary["reward"] == 0
    truth = seen["robot.truth"][0]
    assert isinstance(truth, Truth)
    assert truth.labels == ("peg", "socket", "left gripper", "right gripper")
    percept, joints = seen["manipulation.out"][-1], seen["robot.joints"]
    assert isinstance(percept, Percept)
    assert percept.action.shape == (100 * 14,)  # the whole chunk
    first, last = joints[0], joints[-1]
    assert isinstance(first, Joints)
    assert isinstance(last, Joints)
    assert np.abs(last.positions - first.positions).max() > 0.01


@needs_robot
def test_a_seed_is_one_trial() -> None:
    def commands() -> str:
        plan = load(GRAPH, Overlay(changes=("robot.seed=80004", "robot.frames=8")))
        with InlineRunner(plan) as runner:
            list(runner.run())
        return runner.commands.hexdigest()  # of windows and targets

    assert commands() == commands()
