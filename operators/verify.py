"""Verify candidates by a detector in the ROI: RoiFeatures, Detections, Tracks -> RoiFeatures.

Encoder and detector are asked for the same pixels: what both take for the target is it sooner than
what one of them does. `genuine` of the target's class is their common probability at even odds.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from pipeline import Detections, Frame, Input, Operator, RoiFeatures, SettingsError, Tracks
from pipeline.boxes import centres, sizes
from pipeline.contract import BEFORE
from pipeline.errors import FoveaError

# Gains of the logits of the detector's score and of the encoder's probability, beside the score in
# the context, which the policy counts: a logistic regression over 1,562 candidates in stills of the
# development match, 29 of them balls, with the detector `larger`. On the matches left out a ball is
# rated above another candidate in .975 of the pairs, by the context alone in .935, by the score in
# the ROI alone in .965, by the encoder in .948 (python -m bench.second_look). Fitted anew to `roi`
# the gains are no better there and were worse in the loop: operators/saliency/cards/roi.md.
OF_SCORE, OF_ENCODER = 1.46, 0.58
LEAST = 0.005  # shares are clipped to LEAST .. 1 - LEAST
UNKNOWN = 1.0  # what an encoder says that verifies nothing
EVEN = 0.5
PEOPLE = ("player", "goalkeeper", "referee", "person")
MOST_LISTED, LONGEST_NAME = 100, 100  # in a sentence: class names, and letters of one
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class VerifySettings:
    """What a graph may set. Distances are pixels of the sensor."""

    target: str = "ball"  # the class that is looked at again
    reach_px: float = 16.0  # between the centres of a candidate and of what the ROI shows of it
    edge_px: float = 30.0  # candidates nearer to the edge of the ROI are not judged
    # sides of the target as shares of the height of people: what is smaller or larger is none
    smallest: float = 0.05
    largest: float = 0.26

    def __post_init__(self) -> None:
        if not self.target:
            raise SettingsError("target: expected the name of a class, got none")
        for name in ("reach_px", "edge_px", "smallest"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must not be negative, got {getattr(self, name)}")
        if self.largest <= self.smallest:
            raise SettingsError(f"largest: must be above smallest, got {self.largest}")


class Verify(Operator[VerifySettings, RoiFeatures]):
    """One answer per ROI. Candidates at its edge are left out, other classes are passed on.

    One that the context misses in this exposure is judged where it is foreseen.
    """

    features = Input(RoiFeatures, keep="latest")
    closer = Input(Detections, keep="latest")
    tracks = Input(Tracks, keep="latest")
    roi = Input(Frame, keep="latest")

    @classmethod
    def advise(cls, settings: VerifySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `SettingsError` for a class that the detector does not know."""
        for before in upstream.get(BEFORE, ()):
            try:
                names = getattr(before, "reported_classes", None)
            except FoveaError:  # weights that are not there: its own node says so
                continue
            if names and settings.target not in names:
                known, got = ", ".join(names[:MOST_LISTED]), settings.target[:LONGEST_NAME]
                raise SettingsError(f"target: expected one of {known}, got {got}")
        return ()

    def on_features_closer_tracks_roi(
        self, features: RoiFeatures, closer: Detections, tracks: Tracks, roi: Frame
    ) -> RoiFeatures:
        """Return the features with what both networks say of the target."""
        settings, boxes = self.settings, tracks.boxes[:, -1]
        found = finds(closer, height_of_people(boxes, tracks.labels, tracks.names), settings)
        own = [k for k, name in enumerate(tracks.names) if name == settings.target]
        targets = np.flatnonzero(np.isin(tracks.labels, own))
        scores = best_scores(boxes[targets], closer, found, settings.reach_px)
        shown = well_inside(boxes, roi, settings.edge_px)
        ids = tracks.ids[targets].tolist()
        judged = dict(zip(ids, zip(targets, scores, strict=True), strict=True))
        genuine, kept = features.genuine.copy(), np.ones(len(features.ids), np.bool_)
        for index, object_id in enumerate(features.ids.tolist()):
            if object_id not in judged:
                continue
            row, score = judged[object_id]
            kept[index] = shown[row]
            encoder = EVEN if genuine[index] == UNKNOWN else genuine[index]
            by_score, by_encoder = logit(np.clip([score, encoder], LEAST, 1 - LEAST))
            genuine[index] = expit(OF_SCORE * by_score + OF_ENCODER * by_encoder)
        return replace(
            features,
            ids=features.ids[kept],
            features=features.features[kept],
            genuine=genuine[kept],
        )


def best_scores(
    boxes: Array, closer: Detections, found: NDArray[np.intp], reach_px: float
) -> Array:
    """Return the score of the best find at each box, 0 without one: (n,).

    A find belongs to the nearest box only, so that it does not verify a boot beside the ball.
    """
    scores = np.zeros(len(boxes), np.float32)
    away = distances(boxes, closer.boxes[found])
    if not away.size:
        return scores
    for row, nearest, apart in zip(found, away.argmin(0), away.min(0), strict=True):
        if apart <= reach_px:
            scores[nearest] = max(scores[nearest], closer.scores[row])
    return scores


def height_of_people(boxes: Array, labels: NDArray[np.int32], names: Sequence[str]) -> float:
    """Return the median height of people, pixels; 0 where there are none."""
    people = np.isin(labels, [k for k, name in enumerate(names) if name in PEOPLE])
    return float(np.median(boxes[people, 3] - boxes[people, 1])) if people.any() else 0.0


def finds(closer: Detections, height_px: float, settings: VerifySettings) -> NDArray[np.intp]:
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
