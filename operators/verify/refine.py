"""Correct detections by what the ROI shows: Detections, those of the ROI, its Frame -> Detections.

In the context a ball is two pixels wide, and boots, scraps and lines look alike. Where the ROI
shows a candidate at full resolution, the place and score there stand in its place; a candidate of
which nothing is found there counts less; and what only the ROI shows is added.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from operators.verify.second_look import (
    SecondLookSettings,
    distances,
    finds,
    height_of_people,
    well_inside,
)
from pipeline import Detections, Frame, Input, Operator, SettingsError

MISSED = 0.3  # of the score of a candidate that the ROI does not show
WAIT_MS = 50.0  # realtime: for the look at the ROI of this exposure
FIELDS = ("boxes", "angles", "scores", "labels", "features")


@dataclass(frozen=True, kw_only=True)
class RefineSettings(SecondLookSettings):
    """What a graph may set."""

    least_score: float = 0.3  # of what the ROI shows, to count

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.least_score <= 1:
            raise SettingsError(f"least_score: must be within 0..1, got {self.least_score}")


class Refine(Operator[RefineSettings, Detections]):
    """One answer per context; unchanged where its exposure has no ROI.

    Both detectors have the same classes and features.
    """

    detections = Input(Detections, keep="every")
    closer = Input(Detections, keep="latest", optional=True, wait_ms=WAIT_MS)
    roi = Input(Frame, keep="latest", optional=True, wait_ms=WAIT_MS)

    def on_detections_closer_roi(
        self, detections: Detections, closer: Detections | None, roi: Frame | None
    ) -> Detections:
        """Return the detections with those of the target corrected."""
        if closer is None or roi is None:
            return detections
        settings, names = self.settings, detections.names
        height_px = height_of_people(detections.boxes, detections.labels, names)
        rows = finds(closer, height_px, settings)
        rows = rows[closer.scores[rows] >= settings.least_score]
        rows = rows[np.argsort(-closer.scores[rows], kind="stable")]
        label = names.index(settings.target) if settings.target in names else -1
        judged = well_inside(detections.boxes, roi, settings.edge_px)
        judged &= detections.labels == label
        away = distances(detections.boxes, closer.boxes[rows])
        boxes, scores = detections.boxes.copy(), detections.scores.copy()
        scores[judged] *= MISSED
        free = judged.copy()
        fresh = []
        for column, row in enumerate(rows):
            near = np.where(free, away[:, column], np.inf)
            if len(near) and near.min() <= settings.reach_px:
                own = int(near.argmin())
                free[own] = False
                boxes[own] = closer.boxes[row]
                scores[own] = max(detections.scores[own], closer.scores[row])
            else:
                fresh.append(row)
        corrected = replace(detections, boxes=boxes, scores=scores)
        if not fresh or label < 0:
            return corrected
        added = {name: getattr(closer, name)[fresh] for name in FIELDS}
        added["labels"] = np.full(len(fresh), label, np.int32)
        both: dict[str, Any] = {
            name: np.concatenate([getattr(corrected, name), added[name]]) for name in FIELDS
        }
        return replace(corrected, **both)
