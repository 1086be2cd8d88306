"""A procedural soccer broadcast in a fictitious stadium, with exact ground truth."""

from drivers.scenes.soccer.scene import SoccerScene

__all__ = ["SoccerScene"]
