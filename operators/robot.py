"""Operate a robot: ROI schedules and actions in, context, ROI and joints of each exposure out.

A simulated robot that knows the ground truth also sends it, for scoring.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import DTypeLike, NDArray

from drivers.robot import Joints
from drivers.robot import Robot as Driver
from pipeline.contract import Input, Output, Source
from pipeline.errors import DriverError, MessageError, SettingsError
from pipeline.forecast import Forecast, Upstream
from pipeline.import_path import imported
from pipeline.messages import Frame, Message, Percept, RoiSchedule, Truth
from pipeline.settings import build


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """The driver's class and its own settings."""

    robot: str = "drivers.simulated:SimulatedRobot"  # import path module:Class
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.build()  # so that errors are raised before a process starts

    @property
    def shows(self) -> str:
        """The kind of scene before the sensor; empty if unknown."""
        return str(getattr(self.build(), "shows", ""))

    @property
    def source(self) -> str:
        """The origin of the pictures, for messages."""
        return str(getattr(self.build(), "source", self.robot))

    def build(self) -> Driver:
        """Return the driver, not yet open; raises `SettingsError`."""
        found = imported(self.robot, SettingsError, "robot")
        if not hasattr(found, "settings_type") or not hasattr(found, "act"):
            raise SettingsError(f"robot: expected a driver that takes targets, got {self.robot}")
        built: Driver = found(build(found.settings_type, self.options, "options"))
        return built


class Robot(Source[RobotSettings, Frame]):
    """Exposes at the robot's rate; commands of sensor and arms come by another thread.

    The action of a percept of frame k is one or more rows of targets, flattened: those of frame k
    and of the frames after it. An empty action commands nothing.
    """

    schedule = Input(RoiSchedule, command=True)
    action = Input(Percept, command=True)
    context = Output(Frame)
    roi = Output(Frame)
    joints = Output(Joints)
    truth = Output(Truth)

    _robot: Driver | None = None
    _joints = 0  # how many it has

    @classmethod
    def forecast(cls, settings: RobotSettings, upstream: Upstream) -> Forecast:
        """Return what the driver states by its options."""
        states = getattr(settings.build(), "forecast", None)
        if states is None:
            return Forecast(note=f"{settings.robot} does not state its streams")
        found: Forecast = states()
        return found

    def open(self) -> None:
        """Open and start the device."""
        self._robot = robot = self.settings.build()
        robot.open(realtime=self.realtime)
        robot.start()
        self._joints = len(robot.joints()[0])

    def on_schedule(self, schedule: RoiSchedule) -> None:
        """Pass a command to the sensor."""
        self._opened().set_rois(schedule)

    def on_action(self, action: Percept) -> None:
        """Pass targets to the arms."""
        numbers = action.action
        if not len(numbers):
            return
        robot = self._opened()
        if len(numbers) % self._joints:
            raise MessageError(
                f"robot.action: expected rows of {self._joints} joints, got {len(numbers)} numbers"
            )
        robot.act(action.header.seq, numbers.reshape(-1, self._joints))

    def produce(self) -> Mapping[str, Message] | None:
        """Return the next exposure, one message per stream, with the joints."""
        robot = self._opened()
        exposure = robot.read(self._memory)
        if exposure is None:
            return None
        header = exposure.header
        positions, velocities = robot.joints()
        answers: dict[str, Message] = {
            "context": exposure.context,
            "roi": exposure.roi,
            "joints": Joints(header=header, positions=positions, velocities=velocities),
        }
        if (known := exposure.truth) is not None:
            answers["truth"] = Truth(
                header=header,
                boxes=known.boxes,
                ids=known.ids,
                labels=known.labels,
                visibility=known.visibility,
            )
        return answers

    def summary(self) -> Mapping[str, Any]:
        """Return the driver's figures."""
        return self._robot.summary() if self._robot else {}

    def close(self) -> None:
        """Stop and release the device."""
        if self._robot is not None:
            self._robot.stop()
            self._robot.close()

    def _memory(
        self, output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        return self.loan(shape, dtype, output, ahead=ahead)

    def _opened(self) -> Driver:
        if self._robot is None:
            raise DriverError(f"robot: {self.settings.robot} is not open")
        return self._robot
