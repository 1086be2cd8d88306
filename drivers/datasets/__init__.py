"""Recordings as frame sources: tracking data sets with their truth, videos, folders of pictures."""

from drivers.datasets.aloha import AlohaEpisode
from drivers.datasets.images import ImageFolder
from drivers.datasets.mot import MotSequence
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.datasets.texts import PannedPictures, RoadTextVideo
from drivers.datasets.video import VideoFile

__all__ = [
    "AlohaEpisode",
    "ImageFolder",
    "MotSequence",
    "PannedPictures",
    "RoadTextVideo",
    "SoccerNetSequence",
    "VideoFile",
]
