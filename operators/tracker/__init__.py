"""Tracker: context and ROI -> where the one followed object is."""

from operators.tracker.tracker import Tracker, TrackerSettings, TrackerState

__all__ = ["Tracker", "TrackerSettings", "TrackerState"]
