"""Procedural scenes, drawn on request, with exact ground truth."""

from drivers.scenes.panorama import PanoramaScene
from drivers.scenes.soccer import SoccerScene

__all__ = ["PanoramaScene", "SoccerScene"]
