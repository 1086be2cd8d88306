"""Data sets of texts in pictures and videos, with their transcriptions."""

from drivers.datasets.texts.panned import PannedPictures
from drivers.datasets.texts.roadtext import RoadTextVideo

__all__ = ["PannedPictures", "RoadTextVideo"]
