"""The simulated dual-stream sensor and its settings."""

from drivers.simulated.settings import SimulatedSensorSettings
from drivers.simulated.simulated import SimulatedSensor

__all__ = ["SimulatedSensor", "SimulatedSensorSettings"]
