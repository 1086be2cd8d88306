"""Training clips of the policy: seeds -> recorded outputs of the loop, on disk.

Outputs that depend only on the context are the same wherever the ROI is, so they are computed once,
by the operators in the in-line runner (graphs/tasks/tracking_recording.yaml). The appearance of
every object at full resolution is stored, too; a roll-out reveals it where its ROI looks.
"""

from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.training import arrays as files
from operators.training.arrays import Arrays
from operators.training.identity import Identity, of_code, of_plan
from operators.training.progress import tracked
from operators.training.workers import pool_of
from pipeline import Geometry, RoiFeatures, Tracks, Truth
from pipeline.errors import DriverError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import TASKS
from pipeline.messages import Header, Message
from pipeline.run.inline import InlineRunner

GRAPH = TASKS / "tracking_recording.yaml"
TRAIN_SEEDS, VALIDATION_SEEDS = 30_000, 40_000  # no other part of the project uses them
KEPT = ("association.out", "roi_features.out", "capture.truth")


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """One frame of a recording."""

    tracks: Tracks
    seen: RoiFeatures  # for every track, as if the ROI contained all of them
    truth: Truth


class Recording:
    """One clip; the messages of a frame are assembled on request."""

    def __init__(self, path: Path) -> None:
        self._arrays = files.read(path)
        if self._arrays.get("geometry", np.zeros(0)).shape != (5,):
            raise DriverError(f"{path}: expected a recording of this version; record it again")
        self.path = path

    def __len__(self) -> int:
        return len(self._arrays["seqs"])

    @cached_property
    def geometry(self) -> Geometry:
        """Field and ROI of the sensor."""
        width, height, roi_width, roi_height, step = self._arrays["geometry"].tolist()
        return Geometry(
            width_px=width,
            height_px=height,
            roi_width_px=roi_width,
            roi_height_px=roi_height,
            step_px=step,
        )

    @cached_property
    def sides(self) -> dict[str, int]:
        """What a network for these clips must take."""
        observed, context_channels = self._arrays["features"].shape[1:]
        return {
            "roi_channels": self._arrays["roi"].shape[1],
            "context_channels": context_channels,
            "observed": observed,
            "horizon": self._arrays["predicted"].shape[1],
        }

    def header(self, frame: int) -> Header:
        """The header of frame `frame`, counted from 0."""
        seq = int(self._arrays["seqs"][frame])
        return Header(stream=self.path.stem, seq=seq, stamp_ns=0, geometry=self.geometry)

    def moment(self, frame: int) -> Moment:
        """Frame `frame`, counted from 0; IndexError past the end."""
        header, a = self.header(frame), self._arrays
        rows = slice(a["first"][frame], a["first"][frame + 1])
        known = slice(a["truth_first"][frame], a["truth_first"][frame + 1])
        shown = a["shown"][rows]
        return Moment(
            tracks=Tracks(
                header=header,
                ids=a["ids"][rows],
                labels=a["labels"][rows],
                scores=a["scores"][rows],
                boxes=a["boxes"][rows],
                visible=a["visible"][rows],
                features=a["features"][rows].astype(np.float32),
                predicted=a["predicted"][rows],
                names=tuple(a["names"].tolist()),
            ),
            seen=RoiFeatures(
                header=header,
                ids=a["ids"][rows][shown],
                features=a["roi"][rows][shown].astype(np.float32),
                genuine=a["genuine"][rows][shown],
            ),
            truth=Truth(
                header=header,
                boxes=a["truth_boxes"][known],
                ids=a["truth_ids"][known],
                labels=tuple(a["truth_labels"][known].tolist()),
                visibility=a["truth_visible"][known],
            ),
        )

    def path_of(self, object_id: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return an object's true boxes (F, 4) and visible share (F,); 0 where it is absent."""
        a, frames = self._arrays, len(self)
        boxes, visible = np.zeros((frames, 4), np.float32), np.zeros(frames, np.float32)
        for row in np.flatnonzero(a["truth_ids"] == object_id):
            frame = int(np.searchsorted(a["truth_first"], row, side="right")) - 1
            boxes[frame], visible[frame] = a["truth_boxes"][row], a["truth_visible"][row]
        return boxes, visible

    @cached_property
    def people_and_ball(self) -> dict[int, str]:
        """Return the label of every true object of the clip, by id."""
        pairs = zip(self._arrays["truth_ids"], self._arrays["truth_labels"], strict=True)
        return {int(i): str(label) for i, label in pairs}


def made_with(frames: int, changes: tuple[str, ...] = (), graph: Path = GRAPH) -> dict[str, str]:
    """Return what determines a recording besides its seed; raises `FoveaError` for bad changes.

    `changes` are settings as `--set` takes them, e.g. other weights for the detector.
    """
    plan = load(graph, Overlay(changes=changes, clock="lockstep"))
    return of_plan(plan) | of_code("drivers") | {"frames": str(frames)}


def record(
    seeds: Iterable[int],
    frames: int,
    folder: Path,
    *,
    workers: int = 2,
    changes: tuple[str, ...] = (),
    say: Callable[[str], None] = print,
    name: str = "record clips",
    graph: Path = GRAPH,
) -> list[Path]:
    """Record the first `frames` frames of each seed's scene; clips already there are kept.

    Clips that are damaged, or were recorded with other settings, networks or code, are recorded
    again one by one, so that a retrained detector needs no other folder.
    """
    made = made_with(frames, changes, graph)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [folder / f"{seed}.npz" for seed in seeds]
    missing = files.outdated(wanted, made, say)
    with pool_of(workers) as pool:
        jobs = [pool.submit(_record, path, frames, changes, made, graph) for path in missing]
        for job in tracked(jobs, name):
            job.result()
    return wanted


def _record(path: Path, frames: int, changes: tuple[str, ...], made: Identity, graph: Path) -> None:
    """One clip; its file is named after its seed."""
    cv2.setNumThreads(1)
    own = (f"capture.options.seed={path.stem}", f"capture.options.frames={frames}")
    plan = load(graph, Overlay(changes=(*own, *changes), clock="lockstep"))
    heard: list[dict[str, Message]] = [{}]
    with InlineRunner(
        plan, watch=lambda output, message: heard[-1].update({output: message})
    ) as run:
        for _ in run.run(frames):
            heard[-1] = {name: heard[-1][name] for name in KEPT}  # not the pictures
            heard.append({})
    files.write(path, arrays(heard[:-1]), made)


def arrays(heard: list[dict[str, Any]]) -> Arrays:
    """Concatenate the messages of all frames; features in half precision."""
    tracks: list[Tracks] = [h["association.out"] for h in heard]
    truths: list[Truth] = [h["capture.truth"] for h in heard]
    appearance = [aligned(t.ids, h["roi_features.out"]) for t, h in zip(tracks, heard, strict=True)]
    geometry = tracks[0].header.geometry
    channels = max(roi.shape[1] for roi, _, _ in appearance)
    shared = max(t.features.shape[2] for t in tracks)
    observed = tracks[0].boxes.shape[1]
    return {
        "geometry": np.array(astuple(geometry)),
        "names": np.array(tracks[0].names),
        "seqs": np.array([t.header.seq for t in tracks]),
        "first": np.cumsum([0, *(len(t.ids) for t in tracks)]),
        **{
            name: np.concatenate([getattr(t, name) for t in tracks])
            for name in ("ids", "labels", "scores", "boxes", "visible", "predicted")
        },
        "features": np.concatenate(
            [t.features.reshape(-1, observed, shared) for t in tracks], dtype=np.float16
        ),
        "roi": np.concatenate(
            [a.reshape(-1, channels) for a, _, _ in appearance], dtype=np.float16
        ),
        "genuine": np.concatenate([g for _, g, _ in appearance]),
        "shown": np.concatenate([s for _, _, s in appearance]),
        "truth_first": np.cumsum([0, *(len(t.ids) for t in truths)]),
        "truth_ids": np.concatenate([t.ids for t in truths]),
        "truth_boxes": np.concatenate([t.boxes for t in truths]),
        "truth_visible": np.concatenate([t.visibility for t in truths]),
        "truth_labels": np.array([label for t in truths for label in t.labels]),
    }


def aligned(
    ids: NDArray[np.int32], seen: RoiFeatures
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Appearance in the order of `ids` (n,): features (n, D), genuine (n,), whether shown (n,)."""
    shown = np.isin(ids, seen.ids)
    roi = np.zeros((len(ids), seen.features.shape[1]), np.float32)
    genuine = np.ones(len(ids), np.float32)
    rows = np.searchsorted(seen.ids, ids[shown])  # both ascend
    roi[shown], genuine[shown] = seen.features[rows], seen.genuine[rows]
    return roi, genuine, shown
