"""The graph's tracks of all objects against the truth: a clip -> HOTA, AssA, IDF1, by TrackEval.

Scored are people, or the ball, in the frames of a clip, as association tracks them in what a
strategy's pictures show. A track counts in the frames in which it was detected. People whom the
truth calls hidden are in neither count.

Strategies with a ROI have the tracks of the context of their budget, and identities by what the
ROI showed (identities.py). `context` is those tracks alone, the floor; `everybody` is shown
everybody at full resolution in every frame, `recognised` also tells without error who is shown, and
`truth` names every track rightly.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import CONTEXT, PURSUIT, acquisition
from bench.tracking.camera import Camera
from bench.tracking.cases import Protocol
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.identities import (
    CENTRED,
    EVERYBODY,
    ORACLE,
    RECOGNISED,
    ROI_STAGES,
    TRUTH,
    Played,
    identified,
)
from bench.tracking.metrics import metrics
from bench.tracking.options import Options, refuse_too_late
from bench.tracking.replaced import Replaced
from bench.tracking.sight import PERCEPTION, watched
from bench.tracking.stages import Stages
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from operators.identity import IdentitySettings
from pipeline import settings as checked
from pipeline.boxes import iou
from pipeline.errors import SettingsError
from pipeline.messages import Tracks

PICTURES = ("full", "spatial", CONTEXT)  # with pictures of their own in every frame
PLANNED = ("foveated", "greedy", PURSUIT, "round_robin")
LOOKS = (*PLANNED, CENTRED, ORACLE, EVERYBODY, RECOGNISED, TRUTH)
STRATEGIES = (*PICTURES, *LOOKS)
IDENTITY = "identity"  # node of a graph
GROUPS: Mapping[str, tuple[str, ...]] = {"people": ("player", "referee"), "ball": ("ball",)}
SAME_IOU = 0.5  # from which an unseen person and a track are one
Row = dict[str, Any]
Looks = Mapping[tuple[str, str], Stages]  # by name and policy of a strategy


def wanted_of(options: Options) -> list[str]:
    """Return the strategies asked for that can be scored; raises `SettingsError` without any."""
    wanted = [name for name in options.strategies if name in STRATEGIES]
    if not wanted:
        raise SettingsError(
            f"strategies: with --many expected {', '.join(STRATEGIES)}, "
            f"got {', '.join(options.strategies)}"
        )
    return wanted


def many(name: ClipName, options: Options, protocol: Protocol) -> list[Row]:
    """Return a row for each group, strategy and budget of a clip."""
    found = []
    with opened(options, protocol) as (sight, looks):
        clip = read(name, protocol.frames)
        played = (
            *_pictures(clip, sight, wanted_of(options), options),
            *_looks(clip, sight, looks, options),
        )
        for row, tracks in played:
            found += [
                {"clip": str(name), "target": group} | row | scored(clip, tracks, group)
                for group in GROUPS
            ]
        clip.close()
    return found


@contextmanager
def opened(options: Options, protocol: Protocol) -> Iterator[tuple[Stages, Looks]]:
    """Open the graph's perception, and the stages of each strategy with a ROI.

    Raises `SettingsError` for plans that come too late to be followed.
    """
    graph, wanted = Path(protocol.graph), wanted_of(options)
    with ExitStack() as stack:
        sight = stack.enter_context(Stages(graph, options.changes, needed=PERCEPTION))
        looks = {
            (name, policy): stack.enter_context(
                Stages(graph, options.changes, policy=policy, needed=ROI_STAGES)
            )
            for name, policy in policies(wanted, options)
        }
        for stages in looks.values():
            refuse_too_late(max(options.delay), stages.settings("policy").horizon)
        yield sight, looks


def policies(wanted: Sequence[str], options: Options) -> Iterator[tuple[str, str]]:
    """Yield name and policy, as `Stages` takes it, of each strategy with a ROI."""
    for name in wanted:
        if name == "foveated":
            for label, path in options.policy.items():
                yield f"{name} {label}".strip(), path
        elif name in LOOKS:
            yield name, name if name in PLANNED else "round_robin"  # needs no network


Found = Iterator[tuple[Row, Mapping[int, Tracks]]]


def _pictures(clip: Clip, sight: Stages, wanted: Sequence[str], options: Options) -> Found:
    """Yield the tracks of strategies that have pictures of their own in every frame."""
    for strategy in (name for name in wanted if name in PICTURES):
        for budget in options.budgets[: 1 if strategy == "full" else None]:
            camera = Camera(clip, acquisition(strategy, budget, clip.size_px))
            told = {"strategy": strategy, "budget": str(1 if strategy == "full" else budget)}
            yield told, _watched(camera, sight, clip, options)


def _looks(
    clip: Clip,
    sight: Stages,
    looks: Looks,
    options: Options,
) -> Found:
    """Yield the tracks of strategies with a ROI, named by what it showed."""
    for budget in options.budgets if looks else ():
        how = acquisition("foveated", budget, clip.size_px)
        camera = Camera(clip, how)
        tracks = _watched(camera, sight, clip, options)
        for (name, _), stages in looks.items():
            late = options.delay if name.split()[0] in PLANNED else (0,)
            for delay in late:
                played = Played(
                    camera=camera, stages=stages, tracks=tracks, truths=clip.truths,
                    identity=identity_of(stages), delay=delay,
                )  # fmt: skip
                seen = identified(played, name)
                told = {"strategy": name + (f", delay {delay}" if delay else "")}
                yield told | {"budget": str(budget), "looks": seen.looks}, seen.tracks


def _watched(camera: Camera, sight: Stages, clip: Clip, options: Options) -> Mapping[int, Tracks]:
    return watched(camera, sight, len(clip.truths), Replaced(), missed=options.missed)


def identity_of(stages: Stages) -> IdentitySettings:
    """Return the settings of the graph's node `identity`, or without one the defaults."""
    given = {node.name: node.settings for node in stages.plan.nodes}.get(IDENTITY, {})
    found: IdentitySettings = checked.build(IdentitySettings, given, IDENTITY)
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
