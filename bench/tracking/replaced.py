"""Parts of the loop replaced by the ground truth, to measure the error of each."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.tracking.targets import Target
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from pipeline.boxes import centres, iou
from pipeline.errors import SettingsError
from pipeline.messages import Detections, Scanpath, Tracks, altered

PARTS = ("detections", "association", "prediction", "policy", "tracker")
SAME_IOU = 0.3  # from which a track or a detection is assigned to an object of the truth
SHOWN = 0.5  # share of the target inside the ROI from which a perfect tracker sees it


@dataclass(frozen=True, kw_only=True, eq=False)
class Replaced:
    """The parts that are replaced by the truth; answers of the others are not changed."""

    parts: frozenset[str] = frozenset()
    truths: Sequence[Annotations] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise SettingsError(f"replace: expected {', '.join(PARTS)}, got {part}")

    def detections(self, found: Detections, frame: int) -> Detections:
        """Return the true objects, with the features of detections at the same places."""
        if "detections" not in self.parts:
            return found
        truth = self.truths[frame]
        known = np.array([label in CLASS_OF_ROLE for label in truth.labels], np.bool_)
        rows = np.flatnonzero((truth.visibility >= LEAST_VISIBLE) & known)
        names = [CLASS_OF_ROLE[truth.labels[k]] for k in rows]
        boxes = truth.boxes[rows]
        features = np.zeros((len(rows), found.features.shape[1]), np.float32)
        if len(found.boxes) and len(rows):
            overlap = iou(boxes, found.boxes)
            same = overlap.max(1) >= SAME_IOU
            features[same] = found.features[overlap.argmax(1)[same]]
        return altered(
            found,
            boxes=boxes,
            angles=np.zeros(len(rows), np.float32),
            scores=np.ones(len(rows), np.float32),
            labels=np.array([found.names.index(name) for name in names], np.int32),
            features=features,
        )

    def tracks(self, tracks: Tracks, frame: int) -> Tracks:
        """Return tracks with true identities, true future boxes, or both."""
        if not self.parts & {"association", "prediction"} or not len(tracks.ids):
            return tracks
        who = self.who(tracks, frame)
        if "prediction" in self.parts:
            tracks = altered(tracks, predicted=self._future(tracks, who, frame))
        if "association" in self.parts:
            ids = np.where(who >= 0, who, 100_000 + tracks.ids).astype(np.int32)
            _, first = np.unique(ids, return_index=True)  # ids ascend; one of duplicates is kept
            names = ("labels", "scores", "boxes", "visible", "features", "predicted")
            tracks = altered(
                tracks, ids=ids[first], **{name: getattr(tracks, name)[first] for name in names}
            )
        return tracks

    def scanpath(self, path: Scanpath, tracks: Tracks, target: Target, frame: int) -> Scanpath:
        """Return the choice of a policy that knows the future places of the target."""
        if "policy" not in self.parts or not len(tracks.ids):
            return path
        horizon = len(path.choice)
        ahead = np.arange(frame + 1, frame + 1 + horizon)
        there = target.boxes[np.minimum(ahead, len(target.boxes) - 1)]
        options = np.concatenate([tracks.predicted[:, :horizon], path.boxes[None]])
        away = np.linalg.norm(centres(options) - centres(there)[None], axis=-1)
        best = away.argmin(0)
        ids = np.append(tracks.ids, -1).astype(np.int32)
        return altered(path, choice=ids[best], boxes=options[best, np.arange(horizon)])

    def percept(
        self, box: NDArray[np.float32], truth: NDArray[np.float32], shown: float
    ) -> NDArray[np.float32]:
        """Return the answer of a perfect tracker if the ROI shows the target."""
        return truth if "tracker" in self.parts and shown >= SHOWN and truth.any() else box

    def who(self, tracks: Tracks, frame: int) -> NDArray[np.int64]:
        """Return the id in the truth of each track, -1: none."""
        truth = self.truths[frame]
        if not len(truth.boxes):
            return np.full(len(tracks.ids), -1)
        overlap = iou(tracks.boxes[:, -1], truth.boxes)
        return np.where(overlap.max(1) >= SAME_IOU, truth.ids[overlap.argmax(1)], -1)

    def _future(self, tracks: Tracks, who: NDArray[np.int64], frame: int) -> NDArray[np.float32]:
        """Return true future boxes of tracks with an id; predicted ones where the truth ends."""
        ahead = tracks.predicted.copy()
        for step in range(ahead.shape[1]):
            if frame + 1 + step >= len(self.truths):
                break
            truth = self.truths[frame + 1 + step]
            place = {int(i): row for row, i in enumerate(truth.ids)}
            for row, i in enumerate(who):
                if int(i) in place:
                    ahead[row, step] = truth.boxes[place[int(i)]]
        return ahead
