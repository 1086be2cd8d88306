"""Run the cases of one clip in a worker process: a clip's name -> a file per case."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2

from bench.tracking.budgets import PLANNED, acquisition
from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.episode import Loop, run
from bench.tracking.key import contents
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Camera, Stages, watched
from bench.tracking.store import Draft, Unit
from bench.tracking.targets import Target, starts, targets
from drivers.commands import Window
from pipeline.messages import Geometry, Tracks

PERCEPTION = ("downsample", "saliency", "association")  # the stages from context to tracks
Work = tuple[Case, Path]  # and the file of its unit
Windows = dict[tuple[int, int], Sequence[Window]]  # by target and start, exposure by exposure
Seen = dict[tuple[str, tuple[int, int], Geometry, bool], list[Tracks]]


def follow(name: ClipName, work: Sequence[Work], protocol: Protocol, warnings_file: Path) -> None:
    """Run cases of a clip; write each of them when it is done."""
    cv2.setNumThreads(1)
    clip = read(name, protocol.frames)
    seed = protocol.seed + max(name.seed, 0)
    subjects = targets(clip.truths, protocol.kinds, players=protocol.players, seed=seed)
    seen: Seen = {}
    looked: dict[Case, Windows] = {}
    with _warnings_into(warnings_file, str(name)):
        for parts in sorted({case.parts for case, _ in work}):
            with Stages(Path(protocol.graph), *parts) as stages:
                for case, path in (w for w in work if w[0].parts == parts):
                    loop = loop_of(clip, case, stages, seen)
                    windows = looked.setdefault(same_windows(case), {})
                    draft = Draft(path.with_suffix(".part"))
                    done = [_followed(loop, t, protocol.every, windows, draft) for t in subjects]
                    told = {"clip": str(name), "case": case.name, "budget": case.budget}
                    draft.finish([unit | told for unit in done], path)


def same_windows(case: Case) -> Case:
    """Return a case that is equal for all cases with the same windows."""
    return replace(case, name="", rules=replace(case.rules, context=True))


def loop_of(clip: Clip, case: Case, stages: Stages, seen: Seen) -> Loop:
    """Return what a case's episodes run in; known tracks of the context are used again."""
    how = acquisition(case.strategy, Fraction(case.budget), clip.size_px)
    camera = Camera(clip, how)
    replaced = Replaced(parts=frozenset(case.replaced), truths=clip.truths)
    loop = Loop(camera=camera, stages=stages, rules=case.rules, replaced=replaced)
    if case.strategy not in PLANNED:
        return loop
    # changes may affect any stage; tracks carry the geometry of the ROI, by which the graph plans
    parts = contents(stages.plan, PERCEPTION)
    context = (parts, how.sampling.context_px, how.geometry, "detections" in case.replaced)
    if context not in seen:
        seen[context] = watched(camera, stages, len(clip.truths), replaced)
    return replace(loop, tracks=seen[context])


def _followed(loop: Loop, target: Target, every: int, windows: Windows, draft: Draft) -> Unit:
    episodes = []
    for start in starts(target, every):
        if episode := draft.known(target.id, start):
            episodes.append(episode)
            continue
        outcome = run(loop, target, start, windows.get((target.id, start), ()))
        windows[target.id, start] = outcome.windows
        if outcome.iou:
            episode = {
                "start": start,
                "iou": [round(v, 4) if v == v else None for v in outcome.iou],
                "kept": outcome.kept,
                "shown": [round(v, 3) if v == v else None for v in outcome.shown],
                "state": list(target.state[outcome.first : outcome.first + len(outcome.iou)]),
                "read_px": outcome.read_px,
                "full_px": outcome.full_px,
            }
            episodes.append(episode)
            draft.add(target.id, episode)
    return {"target": target.id, "kind": target.kind, "episodes": episodes}


@contextmanager
def _warnings_into(path: Path, name: str) -> Iterator[None]:
    """Write the stages' warnings into a file, because they would break the bar on the terminal."""
    handler = logging.FileHandler(path, delay=True)
    handler.setFormatter(logging.Formatter(f"{name}: %(message)s"))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()
