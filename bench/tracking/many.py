"""The graph's tracks of all objects against the truth: a clip -> HOTA, AssA, IDF1, by TrackEval.

Scored are people, or the ball, in the frames of a clip, as association tracks them in what a
strategy's pictures show. A track counts in the frames in which it was detected. People whom the
truth calls hidden are in neither count.
"""

import logging
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from bench.tracking.budgets import CONTEXT, acquisition
from bench.tracking.camera import Camera
from bench.tracking.cases import Protocol
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.options import Options
from bench.tracking.replaced import Replaced
from bench.tracking.sight import watched
from bench.tracking.stages import Stages
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from pipeline.boxes import iou
from pipeline.errors import SettingsError
from pipeline.extras import LateModule
from pipeline.messages import Tracks
from pipeline.terminal import lean_table

STRATEGIES = ("full", "spatial", CONTEXT)  # with pictures of their own in every frame
GROUPS: Mapping[str, tuple[str, ...]] = {"people": ("player", "referee"), "ball": ("ball",)}
FIGURES = ("HOTA", "DetA", "AssA", "IDF1")
SAME_IOU = 0.5  # from which an unseen person and a track are one
log = logging.getLogger(__name__)
metrics = LateModule("trackeval.metrics")
Row = dict[str, Any]


def many(options: Options, clips: Sequence[ClipName], protocol: Protocol) -> list[Row]:
    """Return a row for each clip, group, strategy and budget; raises `SettingsError`."""
    wanted = [name for name in options.strategies if name in STRATEGIES]
    if not wanted:
        raise SettingsError(
            f"strategies: with --many expected {', '.join(STRATEGIES)}, "
            f"got {', '.join(options.strategies)}"
        )
    shares = [(s, b) for s in wanted for b in options.budgets[: 1 if s == "full" else None]]
    found = []
    with Stages(Path(protocol.graph), options.changes, options.tracker) as stages:
        for name in clips:
            clip = read(name, protocol.frames)
            for strategy, budget in shares:
                camera = Camera(clip, acquisition(strategy, budget, clip.size_px))
                tracks = watched(camera, stages, len(clip.truths), Replaced())
                log.info("%s: %s at %s is tracked", name, strategy, budget)
                told = {"strategy": strategy, "budget": str(1 if strategy == "full" else budget)}
                found += [
                    {"clip": str(name), "target": group} | told | scored(clip, tracks, group)
                    for group in GROUPS
                ]
            clip.close()
    return found


def scored(clip: Clip, tracks: Mapping[int, Tracks], group: str) -> Row:
    """Return figures and counts of a clip's tracks of a group of classes."""
    pairs = [matched(clip.truths[k], tracks[k], GROUPS[group]) for k in sorted(tracks)]
    return figures(pairs)


Pair = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]  # true ids, tracks, IoU


def matched(truth: Annotations, tracks: Tracks, classes: Sequence[str]) -> Pair:
    """Return ids of true objects (g,) and tracks (t,) of these classes, and IoU (g, t)."""
    own = np.array([CLASS_OF_ROLE.get(label) in classes for label in truth.labels], np.bool_)
    seen = own & (truth.visibility >= LEAST_VISIBLE)
    names = [tracks.name_of(row) in classes for row in range(len(tracks.ids))]
    rows = np.flatnonzero(np.array(names, np.bool_) & tracks.visible[:, -1])
    boxes = tracks.boxes[rows, -1]
    overlap = iou(truth.boxes[seen], boxes).reshape(int(seen.sum()), len(rows))
    hidden = truth.boxes[own & ~seen]
    if len(hidden) and len(rows):  # a track of a hidden person is neither right nor wrong
        best = overlap.max(0) if len(overlap) else np.zeros(len(rows))
        unseen = (iou(hidden, boxes).max(0) >= SAME_IOU) & (best < SAME_IOU)
        rows, overlap = rows[~unseen], overlap[:, ~unseen]
    return (
        truth.ids[seen].astype(np.int64),
        tracks.ids[rows].astype(np.int64),
        overlap.astype(float),
    )


def figures(pairs: Sequence[Pair]) -> Row:
    """Return HOTA, DetA, AssA (means over IoU .05 to .95), IDF1 (at .5) and counts."""
    true_ids = np.unique(np.concatenate([pair[0] for pair in pairs]))
    track_ids = np.unique(np.concatenate([pair[1] for pair in pairs]))
    data = {
        "gt_ids": [np.searchsorted(true_ids, pair[0]) for pair in pairs],
        "tracker_ids": [np.searchsorted(track_ids, pair[1]) for pair in pairs],
        "similarity_scores": [pair[2] for pair in pairs],
        "num_timesteps": len(pairs),
        "num_gt_ids": len(true_ids),
        "num_tracker_ids": len(track_ids),
        "num_gt_dets": sum(len(pair[0]) for pair in pairs),
        "num_tracker_dets": sum(len(pair[1]) for pair in pairs),
    }
    with redirect_stdout(StringIO()):  # the library prints its settings and times
        hota = metrics.HOTA({"PRINT_CONFIG": False}).eval_sequence(data)
        identity = metrics.Identity({"PRINT_CONFIG": False}).eval_sequence(data)
    means = {name: round(float(np.mean(hota[name])), 4) for name in ("HOTA", "DetA", "AssA")}
    return {
        **means,
        "IDF1": round(float(identity["IDF1"]), 4),
        "frames": len(pairs),
        "objects": len(true_ids),
        "tracks": len(track_ids),
        "boxes": data["num_gt_dets"],
    }


COLUMNS = ("clip", "target", "strategy", "budget", *FIGURES, "objects", "tracks", "frames")


def table_of_many(rows: Sequence[Row]) -> Table:
    """Return a table for a terminal."""
    shown = lean_table()
    for column in COLUMNS:
        shown.add_column(column, justify="left" if column in COLUMNS[:4] else "right")
    for row in rows:
        shown.add_row(*(_cell(row, column) for column in COLUMNS))
    return shown


def markdown_of_many(rows: Sequence[Row]) -> str:
    """Return the same as Markdown."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *([_cell(r, c) for c in COLUMNS] for r in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cell(row: Row, column: str) -> str:
    return f"{row[column]:.3f}" if column in FIGURES else str(row[column])
