"""Verify candidates by a detector in the ROI: RoiFeatures, Detections, Tracks -> RoiFeatures.

Encoder and detector are asked for the same pixels: what both take for the target is it sooner than
what one of them does. `genuine` of the target's class is their common probability at even odds.
"""

from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from operators.verify.second_look import (
    SecondLookSettings,
    distances,
    finds,
    height_of_people,
    well_inside,
)
from pipeline import Detections, Frame, Input, Operator, RoiFeatures, Tracks

# Gains of the logits of the detector's score and of the encoder's probability: a logistic
# regression over 1,561 candidates in stills of the development match, 29 of them balls. On the
# matches left out the area under the curve is .968; of the score in the context .931, of the score
# in the ROI .955, of the encoder .946.
OF_SCORE, OF_ENCODER = 2.3, 0.8
LEAST = 0.005  # shares count as at least that, and at most as one less it


class Verify(Operator[SecondLookSettings, RoiFeatures]):
    """One answer per ROI. Candidates at its edge are left out, other classes are passed on."""

    features = Input(RoiFeatures, keep="latest")
    closer = Input(Detections, keep="latest")
    tracks = Input(Tracks, keep="latest")
    roi = Input(Frame, keep="latest")

    def on_features_closer_tracks_roi(
        self, features: RoiFeatures, closer: Detections, tracks: Tracks, roi: Frame
    ) -> RoiFeatures:
        """Return the features with what both networks say of the target."""
        settings = self.settings
        boxes = tracks.boxes[:, -1]
        places = {int(object_id): row for row, object_id in enumerate(tracks.ids)}
        height_px = height_of_people(boxes, tracks.labels, tracks.names)
        found = finds(closer, height_px, settings)
        away = distances(boxes, closer.boxes[found])
        shown = well_inside(boxes, roi, settings.edge_px)
        genuine, kept = features.genuine.copy(), np.ones(len(features.ids), np.bool_)
        for index, object_id in enumerate(features.ids):
            row = places.get(int(object_id), -1)
            if row < 0 or tracks.name_of(row) != settings.target:
                continue
            kept[index] = shown[row]
            near = found[away[row] <= settings.reach_px]
            score = float(closer.scores[near].max(initial=0))
            by_score, by_encoder = logit(np.clip([score, genuine[index]], LEAST, 1 - LEAST))
            genuine[index] = expit(OF_SCORE * by_score + OF_ENCODER * by_encoder)
        return replace(
            features,
            ids=features.ids[kept],
            features=features.features[kept],
            genuine=genuine[kept],
        )
