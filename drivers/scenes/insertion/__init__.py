"""The insertion task of ALOHA in MuJoCo: simulation, scripted expert, source of pictures."""

from drivers.scenes.insertion.expert import demonstration
from drivers.scenes.insertion.scene import InsertionScene
from drivers.scenes.insertion.simulation import (
    COMPLETE,
    JOINTS,
    PARTIAL,
    STEPS,
    Simulation,
    start_of,
)

__all__ = [
    "COMPLETE",
    "JOINTS",
    "PARTIAL",
    "STEPS",
    "InsertionScene",
    "Simulation",
    "demonstration",
    "start_of",
]
