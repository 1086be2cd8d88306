"""Procedural scenes, drawn on request, with exact ground truth."""

from drivers.scenes.soccer import SoccerScene

__all__ = ["SoccerScene"]
