"""Operation of a robot: targets reach the arms, joints come with frames, figures tell the end."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.robot import Joints
from operators.robot import Robot, RobotSettings
from pipeline.contract import HEADLINE, inputs_of, outputs_of
from pipeline.errors import DriverError, MessageError, SettingsError
from pipeline.messages import Frame, Header, Percept, Truth
from tests.drivers.moving_square import MovingSquare

JOINTS = 3


class Arm(MovingSquare):
    """A world of three joints, which are where the last targets said; the reward is the sum."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.rate_hz = 100.0  # its own
        self._first, self._targets = 0, np.zeros((1, JOINTS), np.float32)
        self._now = np.zeros(JOINTS, np.float32)

    def picture(self, index: int) -> NDArray[np.uint8]:
        row = index - 1 - self._first
        if row >= 0:
            self._now = self._targets[min(row, len(self._targets) - 1)]
        return super().picture(index)

    def act(self, first: int, targets: NDArray[np.float32]) -> None:
        self._first, self._targets = first, targets

    def joints(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._now, np.zeros(JOINTS, np.float32)

    def outcome(self) -> tuple[int, str]:
        return int(self._now.sum()), "it stands still"


def robot(**options: Any) -> Robot:
    own = {"scene": "tests.operators.test_robot:Arm", "frames": 20, "strategy": "full"}
    subject = Robot(RobotSettings(options=own | options))
    subject.realtime = False
    subject.open()
    return subject


def action(seq: int, *values: float) -> Percept:
    return Percept(
        header=Header(stream="s", seq=seq, stamp_ns=0),
        boxes=np.zeros((0, 4), np.float32),
        ids=np.zeros(0, np.int32),
        scores=np.zeros(0, np.float32),
        action=np.array(values, np.float32),
    )


def positions(subject: Robot) -> list[float]:
    answers = subject.produce()
    assert answers is not None
    joints = answers["joints"]
    assert isinstance(joints, Joints)
    assert joints.header is answers["context"].header
    return joints.positions.tolist()


def test_it_has_frames_joints_and_truth_and_takes_commands_of_sensor_and_arms() -> None:
    assert outputs_of(Robot) == {"context": Frame, "roi": Frame, "joints": Joints, "truth": Truth}
    assert all(inputs_of(Robot)[name].command for name in ("schedule", "action"))


def test_targets_of_a_frame_show_in_the_next_and_rows_follow_one_another() -> None:
    subject = robot()
    found = [positions(subject)]

    subject.on_action(action(0, 1, 2, 3, 4, 5, 6))
    found += [positions(subject) for _ in range(3)]
    subject.close()

    assert found == [[0, 0, 0], [1, 2, 3], [4, 5, 6], [4, 5, 6]]


def test_an_empty_action_commands_nothing() -> None:
    subject = robot()
    positions(subject)

    subject.on_action(action(0))

    assert positions(subject) == [0, 0, 0]
    subject.close()


def test_frames_that_are_left_out_take_the_rows_of_a_longer_action() -> None:
    subject = robot(strategy="temporal", budget=0.25)
    positions(subject)

    subject.on_action(action(0, *range(12)))

    assert positions(subject) == [9, 10, 11]
    subject.close()


def test_the_report_tells_what_the_trial_has_come_to() -> None:
    subject = robot()
    positions(subject)
    subject.on_action(action(0, 1, 1, 2))
    positions(subject)

    summary = subject.summary()
    subject.close()

    assert (summary["reward"], summary[HEADLINE]) == (4, "it stands still")


def test_an_action_of_other_joints_is_refused() -> None:
    subject = robot()

    with pytest.raises(MessageError, match="expected rows of 3 joints, got 4 numbers"):
        subject.on_action(action(0, 1, 2, 3, 4))
    subject.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"robot": "drivers.simulated:SimulatedSensor"}, "expected a driver that takes targets"),
        ({"robot": "nowhere:Robot"}, "nowhere"),
        ({"options": {"scene": "soccer", "colour": 1}}, "colour"),
    ],
)
def test_what_is_no_robot_is_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        RobotSettings(**settings)


def test_a_world_that_takes_no_targets_is_refused() -> None:
    with pytest.raises(SettingsError, match="expected a world that takes targets"):
        robot(scene="tests.drivers.moving_square:MovingSquare")


def test_another_rate_than_the_worlds_is_refused() -> None:
    with pytest.raises(SettingsError, match="expected 100 of the world"):
        robot(rate_hz=50)


def test_it_must_be_open_to_act() -> None:
    with pytest.raises(DriverError, match="not open"):
        Robot(RobotSettings(options={"scene": "soccer"})).on_action(action(0, 1.0))
