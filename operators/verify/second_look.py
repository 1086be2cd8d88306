"""What both operators share: which objects the ROI shows well, and which of its finds fit them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import Detections, Frame, SettingsError
from pipeline.boxes import centres, sizes

PEOPLE = ("player", "goalkeeper", "referee", "person")
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class SecondLookSettings:
    """What a graph may set. Distances are pixels of the sensor."""

    target: str = "ball"  # the class that is looked at again
    reach_px: float = 16.0  # between the centres of a candidate and of what the ROI shows of it
    edge_px: float = 30.0  # candidates nearer to the edge of the ROI are not judged
    # sides of the target as shares of the height of people: what is smaller or larger is none
    smallest: float = 0.05
    largest: float = 0.26

    def __post_init__(self) -> None:
        for name in ("reach_px", "edge_px", "smallest"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must not be negative, got {getattr(self, name)}")
        if self.largest <= self.smallest:
            raise SettingsError(f"largest: must be above smallest, got {self.largest}")


def height_of_people(boxes: Array, labels: NDArray[np.int32], names: Sequence[str]) -> float:
    """Return the median height of people, pixels; 0 where there are none."""
    people = np.isin(labels, [k for k, name in enumerate(names) if name in PEOPLE])
    return float(np.median(boxes[people, 3] - boxes[people, 1])) if people.any() else 0.0


def finds(closer: Detections, height_px: float, settings: SecondLookSettings) -> NDArray[np.intp]:
    """Return the rows of targets of a plausible size: (k,). Without people any size is."""
    named = [k for k, name in enumerate(closer.names) if name == settings.target]
    fit = np.isin(closer.labels, named)
    if height_px:
        share = sizes(closer.boxes) / height_px
        fit &= (share > settings.smallest) & (share < settings.largest)
    return np.flatnonzero(fit)


def well_inside(boxes: Array, roi: Frame, edge_px: float) -> NDArray[np.bool_]:
    """Return which boxes have their centre in the ROI's window, away from its edge: (n,)."""
    if not roi.pixels.size or not len(boxes):
        return np.zeros(len(boxes), np.bool_)
    middle, window = centres(boxes), np.array(roi.window, np.float32)
    return np.asarray(
        ((middle > window[:2] + edge_px) & (middle < window[2:] - edge_px)).all(1), np.bool_
    )


def distances(boxes: Array, others: Array) -> Array:
    """Return the distance between the centres of each pair: (n, m)."""
    if not len(boxes) or not len(others):
        return np.zeros((len(boxes), len(others)), np.float32)
    apart = centres(boxes)[:, None] - centres(others)[None]
    return np.asarray(np.linalg.norm(apart, axis=2), np.float32)
