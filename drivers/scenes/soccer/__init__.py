"""A procedural soccer broadcast in a stadium that does not exist, with exact truth."""

from drivers.scenes.soccer.scene import SoccerScene

__all__ = ["SoccerScene"]
