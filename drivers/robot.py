"""The contract of a robot: a dual-stream sensor that looks at arms, and takes targets for them.

Joint targets in, joint positions beside the two frames of each exposure out. A simulated robot and
a real one fulfil the same contract; `operators.robot` depends only on it.
"""

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.sensor import DualStreamSensor
from drivers.source import FrameSource
from pipeline import Message, Shape

Targets = NDArray[np.float32]  # (T, joints), radians; grippers 0 closed .. 1 open


@dataclass(frozen=True, kw_only=True, eq=False)
class Joints(Message):
    """The joints of a robot at an exposure: radians, grippers 0 closed .. 1 open."""

    positions: Annotated[NDArray[np.float32], Shape.of("joints")]
    velocities: Annotated[NDArray[np.float32], Shape.of("joints")]  # per second


class Robot(DualStreamSensor, Protocol):
    """A sensor in front of arms. It exposes as often as it takes targets."""

    def act(self, first_seq: int, targets: Targets) -> None:
        """Command targets: row i is held between the exposures `first_seq` + i and the next.

        Targets of frames that have passed are not used; after the last row it is held on. A newer
        command replaces an older one. Any thread may call it. Raises `DriverError` for another
        number of joints.
        """
        ...

    def joints(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions and velocities (joints,) at the last exposure; before any, those now."""
        ...


class World(FrameSource, Protocol):
    """A source of pictures that depend on what was done: a simulation. It only goes forward."""

    def act(self, first: int, targets: Targets) -> None:
        """As `Robot.act`, with a frame's index instead of `seq`."""
        ...

    def joints(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions and velocities (joints,) in the last picture."""
        ...

    def outcome(self) -> tuple[int, str]:
        """The reward of the trial so far, and what was achieved, as a sentence."""
        ...
