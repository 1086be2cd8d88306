"""The simulated dual-stream sensor, the simulated robot around it, and their settings."""

from drivers.simulated.robot import SimulatedRobot
from drivers.simulated.settings import SimulatedSensorSettings
from drivers.simulated.simulated import SimulatedSensor

__all__ = ["SimulatedRobot", "SimulatedSensor", "SimulatedSensorSettings"]
