"""The inputs that every policy has, so that one can take the place of another in a graph."""

from typing import TypeVar

from pipeline import Frame, Input, Operator, Percept, RoiFeatures, Scanpath, Tracks

S = TypeVar("S")


class PolicyInputs(Operator[S, Scanpath]):
    """A policy implements `on_tracks`, and the handlers of what else it heeds."""

    tracks = Input(Tracks, keep="every")
    features = Input(RoiFeatures, join=False)
    percept = Input(Percept, join=False)  # of the consumer
    roi = Input(Frame, join=False)  # for its window

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        raise NotImplementedError

    def on_features(self, features: RoiFeatures) -> None:
        """Do nothing."""

    def on_percept(self, percept: Percept) -> None:
        """Do nothing."""

    def on_roi(self, roi: Frame) -> None:
        """Do nothing."""
