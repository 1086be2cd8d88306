"""Run the cases of one clip in a worker process: a clip's name -> a file per case."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2

from bench.tracking.budgets import PLANNED, acquisition
from bench.tracking.camera import Camera
from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.episode import Loop, Outcome, exposures, run
from bench.tracking.key import contents
from bench.tracking.replaced import Replaced
from bench.tracking.sight import PERCEPTION, Sight
from bench.tracking.stages import Stages
from bench.tracking.store import Draft, Episode, Unit
from bench.tracking.targets import Target, starts, targets
from drivers.commands import Window
from drivers.simulated.strategies import Sampling
from pipeline.messages import Geometry

FAR_PX = 1e6  # in a file, of a tracker without an answer
Work = tuple[Case, Path]  # and the file of its unit
Windows = dict[tuple[int, int], Sequence[Window]]  # by target and start, exposure by exposure
Seen = dict[tuple[str, Sampling, Geometry, bool], Sight]


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
                    if case.rules.cue:
                        stages.open_cue()
                    loop = loop_of(clip, case, stages)
                    sight = sight_of(loop, case, len(clip.truths), seen)
                    windows = looked.setdefault(same_windows(case), {})
                    draft = Draft(path.with_suffix(".part"))
                    done = [
                        _followed(loop, sight, t, protocol.every, windows, draft) for t in subjects
                    ]
                    names = {"clip": str(name), "case": case.name, "budget": case.budget}
                    draft.finish([unit | names for unit in done], path)


def same_windows(case: Case) -> Case:
    """Return a case that is equal for all cases with the same windows."""
    rules = replace(case.rules, context=True, local=False, cue=False)
    return replace(case, name="", rules=rules)


def loop_of(clip: Clip, case: Case, stages: Stages) -> Loop:
    """Return what a case's episodes run in, without tracks."""
    camera = Camera(clip, acquisition(case.strategy, Fraction(case.budget), clip.size_px))
    replaced = Replaced(parts=frozenset(case.replaced), truths=clip.truths)
    return Loop(camera=camera, stages=stages, rules=case.rules, replaced=replaced)


def sight_of(loop: Loop, case: Case, frames: int, seen: Seen) -> Sight | None:
    """Return the tracks that a case needs, known ones again; None: it needs none."""
    if case.strategy not in PLANNED and not case.rules.cue:
        return None
    how = loop.camera.how
    # changes may affect any stage; tracks carry the geometry of the ROI, by which the graph plans
    pictures = replace(how.sampling, window_px=(0, 0), roi_px=(0, 0))
    parts = contents(loop.stages.plan, PERCEPTION)
    context = (parts, pictures, how.geometry, "detections" in case.replaced)
    return seen.setdefault(context, Sight(frames))


def _followed(
    loop: Loop, sight: Sight | None, target: Target, every: int, windows: Windows, draft: Draft
) -> Unit:
    episodes = []
    begun = starts(target, every)
    for start in begun[:1] if loop.rules.to_end else begun:
        if episode := draft.known(target.id, start):
            episodes.append(episode)
            continue
        outcome = run(
            _seeing(loop, sight, start), target, start, windows.get((target.id, start), ())
        )
        windows[target.id, start] = outcome.windows
        if outcome.iou:
            episodes.append(told(outcome, target))
            draft.add(target.id, episodes[-1])
    return {"target": target.id, "kind": target.kind, "episodes": episodes}


def _seeing(loop: Loop, sight: Sight | None, start: int) -> Loop:
    """Return the loop with the tracks of the exposures that an episode has."""
    exposed = exposures(loop.camera, start, start + loop.camera.how.sampling.interval)
    if sight is None or not exposed:
        return loop
    tracks = sight.tracks(loop.camera, loop.stages, loop.replaced, exposed[0])
    return replace(loop, tracks=tracks)


def told(outcome: Outcome, target: Target) -> Episode:
    """Return an episode as a file has it; None stands for what is not known."""
    return {
        "start": outcome.start,
        "iou": [round(v, 4) if v == v else None for v in outcome.iou],
        "away_px": [min(round(v, 1), FAR_PX) if v == v else None for v in outcome.away_px],
        "kept": outcome.kept,
        "shown": [round(v, 3) if v == v else None for v in outcome.shown],
        "state": list(target.state[outcome.first : outcome.first + len(outcome.iou)]),
        "read_px": outcome.read_px,
        "full_px": outcome.full_px,
    }


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
