"""A simulated robot: the simulated sensor in front of a world that its targets move."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.robot import Targets, World
from drivers.simulated.simulated import SimulatedSensor
from pipeline.contract import HEADLINE
from pipeline.errors import SettingsError


class SimulatedRobot(SimulatedSensor):
    """A `Robot`: every strategy of the simulated sensor, before arms that act.

    In lockstep the targets that were made from frame k are held from frame k on; in real time those
    of the frames that passed meanwhile are lost, as on a real robot.
    """

    def open(self, *, realtime: bool) -> None:
        """Open the world; raises `SettingsError` for a source that takes no targets."""
        super().open(realtime=realtime)
        source, rate_hz = self._opened(), self._settings.rate_hz
        if not callable(getattr(source, "act", None)):
            raise SettingsError(f"{self.source}: expected a world that takes targets, got pictures")
        if rate_hz and rate_hz != source.rate_hz:
            raise SettingsError(f"rate_hz: expected {source.rate_hz:g} of the world, got {rate_hz}")

    def act(self, first_seq: int, targets: Targets) -> None:
        """Command targets (T, joints) from exposure `first_seq` on."""
        self._world().act(first_seq, targets)

    def joints(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions and velocities (joints,) at the last exposure."""
        return self._world().joints()

    def summary(self) -> Mapping[str, Any]:
        """The sensor's figures, and what the trial has come to."""
        found = dict(super().summary())
        if self._source is None:
            return found
        reward, words = self._world().outcome()
        return found | {"reward": reward, HEADLINE: words}

    def _world(self) -> World:
        return cast(World, self._opened())
