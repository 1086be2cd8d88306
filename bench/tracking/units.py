"""The work of an evaluation, cut into units that are written as they are done: cases x clips."""

import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from fractions import Fraction
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
from tqdm import tqdm

from bench.tracking.budgets import acquisition
from bench.tracking.clip import ClipName, read
from bench.tracking.episode import Rules, run
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Camera, Stages, watched
from bench.tracking.targets import Target, starts, targets
from pipeline.messages import Tracks


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of a table: a strategy at a budget, and what was changed about it."""

    strategy: str
    budget: str  # a fraction
    name: str  # as the table calls it
    rules: Rules
    replaced: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()  # of the graph, as --set takes them


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """What all cases have in common."""

    graph: str
    frames: tuple[int, int]  # first and last, counted from 1
    kinds: tuple[str, ...]
    every: int = 8  # frames between starts
    players: int = 1
    seed: int = 0


Unit = dict[str, Any]  # clip, case, target, kind, episodes: [{start, iou, kept, shown, state}]


def measured(
    clips: Sequence[ClipName],
    cases: Sequence[Case],
    protocol: Protocol,
    folder: Path,
    *,
    jobs: int,
) -> list[Unit]:
    """All units, from the folder where they are known, from work where they are not."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [
        clip for clip in clips if not all(_path(folder, clip, c, protocol).exists() for c in cases)
    ]
    with (
        ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool,
        tqdm(total=len(clips), initial=len(clips) - len(missing), desc="clips", unit="clip") as bar,
    ):
        waiting = [pool.submit(_measure, clip, tuple(cases), protocol, folder) for clip in missing]
        for job in as_completed(waiting):
            job.result()
            bar.update()
    units: list[Unit] = []
    for clip in clips:
        for case in cases:
            units += json.loads(_path(folder, clip, case, protocol).read_text())
    return units


def _measure(clip_name: ClipName, cases: Sequence[Case], protocol: Protocol, folder: Path) -> None:
    """All cases of one clip, each written when it is done."""
    cv2.setNumThreads(1)
    clip = read(clip_name, protocol.frames)
    seed = protocol.seed + max(clip_name.seed, 0)
    subjects = targets(clip.truths, protocol.kinds, players=protocol.players, seed=seed)
    seen: dict[tuple[Any, ...], list[Tracks]] = {}
    for changes in sorted({case.changes for case in cases}):
        with Stages(Path(protocol.graph), changes) as stages:
            for case in cases:
                path = _path(folder, clip_name, case, protocol)
                if case.changes != changes or path.exists():
                    continue
                how = acquisition(case.strategy, Fraction(case.budget), clip.size_px)
                camera = Camera(clip, how)
                replaced = Replaced(parts=frozenset(case.replaced), truths=clip.truths)
                tracks: Sequence[Tracks] = ()
                if case.strategy in ("foveated", "round_robin"):
                    key = (how.sampling.context_px, "detections" in replaced.parts)
                    if key not in seen:
                        seen[key] = watched(camera, stages, len(clip.truths), replaced)
                    tracks = seen[key]
                done = [
                    _followed(camera, stages, tracks, t, case, protocol, replaced) for t in subjects
                ]
                for unit in done:
                    unit |= {"clip": str(clip_name), "case": case.name, "budget": case.budget}
                unfinished = path.with_suffix(".part")
                unfinished.write_text(json.dumps(done))
                unfinished.rename(path)


def _followed(
    camera: Camera,
    stages: Stages,
    tracks: Sequence[Tracks],
    target: Target,
    case: Case,
    protocol: Protocol,
    replaced: Replaced,
) -> Unit:
    episodes = []
    for start in starts(target, protocol.every):
        outcome = run(camera, stages, tracks, target, start, case.rules, replaced)
        if outcome.iou:
            episodes.append(
                {
                    "start": start,
                    "iou": [round(v, 4) if v == v else None for v in outcome.iou],
                    "kept": outcome.kept,
                    "shown": [round(v, 3) if v == v else None for v in outcome.shown],
                    "state": list(target.state[start + 1 : start + 1 + len(outcome.iou)]),
                }
            )
    return {"target": target.id, "kind": target.kind, "episodes": episodes}


def _path(folder: Path, clip: ClipName, case: Case, protocol: Protocol) -> Path:
    """Where a unit is kept; another protocol, another case, another file."""
    told = json.dumps(
        [asdict(case), asdict(protocol), asdict(clip), *_weights(case)], sort_keys=True
    )
    return folder / f"{clip}-{sha256(told.encode()).hexdigest()[:16]}.json"


def _weights(case: Case) -> list[str]:
    """Digests of files that the case names, so that other weights are other units."""
    values = [change.partition("=")[2] for change in case.changes]
    return [sha256(Path(v).read_bytes()).hexdigest() for v in values if v.endswith(".onnx")]
