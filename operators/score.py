"""Compare what a consumer saw with the truth, where the source knows it: Percept, Percept -> IoU.

Who is being followed is settled by overlap when the consumer starts, and again when it starts anew
on another object; until then nothing counts. A class named in the settings is settled by itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.boxes import iou
from pipeline.contract import Input, Operator
from pipeline.errors import SettingsError
from pipeline.messages import Header, Percept

NOBODY = -1
SAME_IOU = 0.3  # from here on somebody is followed: what is beside them overlaps a little, too


@dataclass(frozen=True, kw_only=True)
class ScoreSettings:
    """What a graph may set."""

    label: str = ""  # of the truth to compare with, e.g. ball; empty: whoever is followed
    least_visible: float = 0.25  # share of the object below which a frame does not count

    def __post_init__(self) -> None:
        if not 0 <= self.least_visible <= 1:
            raise SettingsError(f"least_visible: must be within 0..1, got {self.least_visible}")


class Score(Operator[ScoreSettings, None]):
    """Answers nothing; its figure is shown while the graph runs, and in the report."""

    percept = Input(Percept, keep="latest")
    truth = Input(Percept, keep="latest")

    def open(self) -> None:
        """Nothing counted yet."""
        self._followed = self._object_id = NOBODY
        self._total, self._frames, self._recent = 0.0, 0, 0.0

    def on_stream(self, header: Header) -> None:
        """Another stream shows others."""
        self._followed = self._object_id = NOBODY

    def on_percept_truth(self, percept: Percept, truth: Percept) -> None:
        """Count one frame in which both know where the object is."""
        if not len(percept.boxes) or not len(truth.boxes):
            return
        overlap = iou(truth.boxes, percept.boxes[:1])[:, 0]
        row = self._row(percept, truth, overlap)
        if row < 0 or truth.scores[row] < self.settings.least_visible:
            return
        value = float(overlap[row])
        self._recent = value if not self._frames else 0.95 * self._recent + 0.05 * value
        self._total += value
        self._frames += 1

    def headline(self) -> str:
        """The figure of now."""
        return f"IoU {self._recent:.2f}" if self._frames else ""

    def summary(self) -> Mapping[str, Any]:
        """The mean over all frames that counted."""
        if not self._frames:
            return {}
        return {"iou": {"mean": round(self._total / self._frames, 4), "frames": self._frames}}

    def _row(self, percept: Percept, truth: Percept, overlap: Any) -> int:
        """Whom to compare with: a row of the truth, -1: nobody."""
        if self.settings.label:
            rows = np.flatnonzero(np.array(truth.texts) == self.settings.label)
            return int(rows[0]) if len(rows) else -1
        if self._followed == NOBODY or percept.ids[0] != self._object_id:
            if overlap.max() < SAME_IOU:
                return -1
            self._followed = int(truth.ids[overlap.argmax()])
            self._object_id = int(percept.ids[0])
        rows = np.flatnonzero(truth.ids == self._followed)
        return int(rows[0]) if len(rows) else -1
