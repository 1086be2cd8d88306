"""Procedural scenes, drawn on request, with exact ground truth."""

from drivers.scenes.insertion import InsertionScene
from drivers.scenes.panorama import PanoramaScene
from drivers.scenes.road import RoadScene
from drivers.scenes.soccer import SoccerScene
from drivers.scenes.whole_pitch import WholePitchScene

__all__ = ["InsertionScene", "PanoramaScene", "RoadScene", "SoccerScene", "WholePitchScene"]
