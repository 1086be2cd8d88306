"""Many objects under one ROI: tracks of a clip and a strategy of looks -> tracks with identities.

What the context shows does not depend on the ROI, so the tracks of a clip are computed once. Each
strategy then aims the ROI frame by frame, the graph's encoder reads what it shows, and the same
`Identity` operator decides from that who is who.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.tracking.camera import Camera
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Stages
from drivers.commands import Window
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from operators.identity import Identity, IdentitySettings
from operators.policy.greedy import best_window
from pipeline.boxes import centres, iou, roi_window
from pipeline.messages import RoiFeatures, RoiSchedule, Tracks, altered

CENTRED, ORACLE, EVERYBODY = "centred", "oracle", "everybody"
RECOGNISED, TRUTH = "recognised", "truth"
ROI_STAGES = ("roi_features", "policy", "dispatch")
OVERLAP = 0.3  # IoU from which nobody can tell who is who
DOUBT, LOOKS = 4.0, 4  # of the oracle: weight of an interrupted object, looks that end it
PER_TRACK = ("ids", "labels", "scores", "boxes", "visible", "features", "predicted")


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """A clip with its tracks, and the stages that a strategy needs."""

    camera: Camera
    stages: Stages  # `ROI_STAGES`, with the policy of the strategy
    tracks: Mapping[int, Tracks]
    truths: Sequence[Annotations]
    identity: IdentitySettings
    delay: int = 0  # frames by which plans come late


@dataclass(kw_only=True, eq=False)
class Seen:
    """Tracks with identities, and how often the ROI showed people."""

    tracks: dict[int, Tracks] = field(default_factory=dict)
    looks: int = 0  # features of tracks


def identified(played: Played, strategy: str) -> Seen:
    """Return the tracks of a clip, named by what the strategy's ROI showed.

    `everybody` is shown everybody in every frame; for `recognised` those looks also tell without
    error who somebody is; `truth` has the true names of all tracks.
    """
    if strategy == TRUTH:
        known = Replaced(parts=frozenset({"association"}), truths=played.truths)
        return Seen(tracks={k: known.tracks(each, k) for k, each in played.tracks.items()})
    shown = {EVERYBODY: everybody, RECOGNISED: recognised}.get(strategy)
    operator = Identity(played.identity)
    operator.open()
    found = Seen()
    looks = shown(played) if shown else shown_by(played, strategy)
    for frame, features in looks:  # as in the loop, tracks before features
        found.tracks[frame] = operator.on_tracks(played.tracks[frame])
        operator.on_features(features)
        found.looks += len(features.ids)
    return found


def everybody(played: Played) -> Iterator[tuple[int, RoiFeatures]]:
    """Yield what a sensor would show that reads every track at full resolution."""
    camera, stages = played.camera, played.stages
    stages.begin(camera.header(0), "roi_features")
    for frame, tracks in played.tracks.items():
        found: list[RoiFeatures] = []
        for row in range(len(tracks.ids)):
            box = tracks.boxes[row, -1]
            parts = {name: getattr(tracks, name)[row : row + 1] for name in PER_TRACK}
            roi = camera.around(frame, box)
            found.append(stages.looks(roi, altered(tracks, **parts)))
        if found:
            names = ("ids", "features", "genuine")
            parts = {n: np.concatenate([getattr(each, n) for each in found]) for n in names}
            yield frame, altered(found[0], **parts)
        else:
            nothing = camera.nothing(frame)
            yield frame, stages.looks(nothing, tracks)


def recognised(played: Played) -> Iterator[tuple[int, RoiFeatures]]:
    """Yield looks at everybody in which people are alike only to themselves.

    Tracks of nobody are alike to one another.
    """
    known = Replaced(truths=played.truths)
    people = np.unique(np.concatenate([truth.ids for truth in played.truths]))
    directions = np.eye(len(people) + 1, dtype=np.float32)
    for frame, tracks in played.tracks.items():
        who = known.who(tracks, frame)
        rows = np.where(who >= 0, np.searchsorted(people, who), len(people))
        yield (
            frame,
            RoiFeatures(
                header=tracks.header,
                ids=tracks.ids,
                features=directions[rows],
                genuine=np.ones(len(tracks.ids), np.float32),
            ),
        )


def shown_by(played: Played, strategy: str) -> Iterator[tuple[int, RoiFeatures]]:
    """Yield what the encoder reads in the ROI of every frame."""
    path = _path(played, strategy)
    for frame, tracks in played.tracks.items():
        roi = played.camera.roi(frame, path.window(frame))  # raises for one of another size
        path.after_tracks(frame)
        features = played.stages.looks(roi, tracks)
        path.after_features(features)
        yield frame, features


class Planned:
    """Windows by the policy of the stages, in the middle before the first plan."""

    def __init__(self, played: Played) -> None:
        self._played = played
        header = played.camera.header(0)
        known = {"target": "", "delay": played.delay}  # a policy may know how late its plans are
        own = played.stages.settings("policy")
        settings = {name: value for name, value in known.items() if hasattr(own, name)}
        played.stages.begin(header, *ROI_STAGES, policy=settings)
        self._held = in_the_middle(played.camera)
        self._commanded: dict[int, Window] = {}

    def window(self, frame: int) -> Window:
        """Return the window of a frame; call it in the order of frames."""
        self._held = self._commanded.pop(frame, self._held)
        return self._held

    def after_tracks(self, frame: int) -> None:
        """Plan from a frame's tracks."""
        stages, late = self._played.stages, self._played.delay
        scanpath = stages.call("policy", tracks=self._played.tracks[frame])
        schedule: RoiSchedule | None = stages.call("dispatch", scanpath=scanpath)
        if schedule is None:
            return
        for row, window in enumerate(schedule.windows[late:], schedule.first_seq + late):
            left, top, right, bottom = (int(side) for side in window)
            self._commanded[row] = (left, top, right, bottom)

    def after_features(self, features: RoiFeatures) -> None:
        """Tell the policy what the ROI showed."""
        self._played.stages.call("policy", features=features)


class Knowing:
    """Windows by the truth of the same frame.

    Counted is, for each person or ball in view, how long ago the ROI showed it; one whose track
    is another than before counts more until it was shown a few times.
    """

    def __init__(self, played: Played) -> None:
        self._played = played
        self._known = Replaced(parts=frozenset({"association"}), truths=played.truths)
        self._shown: dict[int, int] = {}  # frame of the last look, by true id
        self._track: dict[int, int] = {}  # track, by true id
        self._looks: dict[int, int] = {}  # since its track changed, by true id
        played.stages.begin(played.camera.header(0), "roi_features")

    def window(self, frame: int) -> Window:
        """Return the window of a frame; call it in the order of frames."""
        truth, tracks = self._played.truths[frame], self._played.tracks[frame]
        self._compare(truth, tracks)
        own = np.array([name in CLASS_OF_ROLE for name in truth.labels], np.bool_)
        rows = np.flatnonzero(own & (truth.visibility >= LEAST_VISIBLE))
        if not len(rows):
            return in_the_middle(self._played.camera)
        ids, boxes = [int(i) for i in truth.ids[rows]], truth.boxes[rows]
        shared = iou(boxes, boxes)
        np.fill_diagonal(shared, 0)
        apart = (shared < OVERLAP).all(axis=1)
        age = np.array([frame - self._shown.get(i, -1) for i in ids])
        doubt = np.array([max(1 - self._looks.get(i, 0) / LOOKS, 0) for i in ids])
        gain = age * np.where(apart, 1 + DOUBT * doubt, 1)
        window, inside = best_window(boxes, gain, self._played.camera.how.geometry)
        for row in np.flatnonzero(inside & apart):
            self._shown[ids[row]] = frame
            self._looks[ids[row]] = self._looks.get(ids[row], 0) + 1
        left, top, right, bottom = (int(side) for side in window)
        return left, top, right, bottom

    def _compare(self, truth: Annotations, tracks: Tracks) -> None:
        if not len(tracks.ids) or not len(truth.boxes):
            return
        named = self._known.tracks(tracks, tracks.header.seq)
        overlap = iou(tracks.boxes[:, -1], named.boxes[:, -1])
        for row, who in enumerate(named.ids):
            track = int(tracks.ids[overlap[:, row].argmax()])
            if self._track.get(int(who), track) != track:
                self._looks[int(who)] = 0
            self._track[int(who)] = track

    def after_tracks(self, frame: int) -> None:
        """Do nothing: it knows."""

    def after_features(self, features: RoiFeatures) -> None:
        """Do nothing: it knows."""


class Still:
    """The window in the middle."""

    def __init__(self, played: Played) -> None:
        self._middle = in_the_middle(played.camera)
        played.stages.begin(played.camera.header(0), "roi_features")

    def window(self, frame: int) -> Window:
        """Return the same window in every frame."""
        return self._middle

    def after_tracks(self, frame: int) -> None:
        """Do nothing."""

    def after_features(self, features: RoiFeatures) -> None:
        """Do nothing."""


def _path(played: Played, strategy: str) -> Planned | Knowing | Still:
    kinds: Mapping[str, Any] = {CENTRED: Still, ORACLE: Knowing}
    made: Planned | Knowing | Still = kinds.get(strategy, Planned)(played)
    return made


def in_the_middle(camera: Camera) -> Window:
    """Return the window in the middle of the field."""
    geometry = camera.how.geometry
    field_px = np.array([0, 0, geometry.width_px, geometry.height_px], np.float32)
    return roi_window(centres(field_px), geometry)
