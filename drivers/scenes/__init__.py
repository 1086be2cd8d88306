"""Scenes that are drawn as they are asked for, with exact truth."""

from drivers.scenes.soccer import SoccerScene

__all__ = ["SoccerScene"]
