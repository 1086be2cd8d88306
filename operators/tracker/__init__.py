"""Trackers: context and ROI -> the box of one object. One class per method."""

from operators.tracker.correlation import CorrelationSettings, CorrelationTracker
from operators.tracker.following import TrackerState
from operators.tracker.mixformer import MixFormerTracker, MixFormerTrackerSettings
from operators.tracker.template import TemplateTracker, TemplateTrackerSettings
from operators.tracker.tracker import TrackerSettings
from operators.tracker.vittrack import VitTracker, VitTrackerSettings

__all__ = [
    "CorrelationSettings",
    "CorrelationTracker",
    "MixFormerTracker",
    "MixFormerTrackerSettings",
    "TemplateTracker",
    "TemplateTrackerSettings",
    "TrackerSettings",
    "TrackerState",
    "VitTracker",
    "VitTrackerSettings",
]
