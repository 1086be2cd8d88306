"""Run the cases of one clip in a worker process: a clip's name -> a file per case."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2

from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName, read
from bench.tracking.cue import Cue
from bench.tracking.episode import Loop, Outcome, run
from bench.tracking.stock import Stock
from bench.tracking.store import Draft, Episode, Unit
from bench.tracking.targets import Target, starts, targets
from drivers.commands import Window

FAR_PX = 1e6  # in a file, of a tracker without an answer
Work = tuple[Case, Path]  # and the file of its unit
Windows = dict[tuple[int, int], Sequence[Window]]  # by target and start, exposure by exposure


def follow(name: ClipName, work: Sequence[Work], protocol: Protocol, warnings_file: Path) -> None:
    """Run cases of a clip, a budget after another; write each of them when it is done."""
    cv2.setNumThreads(1)
    clip = read(name, protocol.frames)
    seed = protocol.seed + max(name.seed, 0)
    subjects = targets(
        clip.truths, protocol.kinds, players=protocol.players, seed=seed, width_px=clip.size_px[0]
    )
    looked: dict[Case, Windows] = {}
    budgets = list(dict.fromkeys(case.budget for case, _ in work))
    ordered = sorted(work, key=lambda each: budgets.index(each[0].budget))
    with warnings_into(warnings_file, str(name)), Stock(clip, Path(protocol.graph)) as stock:
        for case, path in ordered:
            loop = stock.loop(case)
            windows = looked.setdefault(same_windows(case), {})
            draft = Draft(path.with_suffix(".part"))
            done = []
            for target in subjects:
                cue = partial(stock.cue, case, target)
                done.append(_followed(loop, cue, target, protocol.every, windows, draft))
            names = {"clip": str(name), "case": case.name, "budget": case.budget}
            draft.finish([unit | names for unit in done], path)
    clip.close()


def same_windows(case: Case) -> Case:
    """Return a case that is equal for all cases with the same windows."""
    rules = replace(case.rules, context=True, local=False, cue=False, cue_delay=0)
    return replace(case, name="", rules=rules)


def _followed(
    loop: Loop,
    cue: Callable[[int], Cue | None],
    target: Target,
    every: int,
    windows: Windows,
    draft: Draft,
) -> Unit:
    """Return a target's unit; `cue` gives that of a start."""
    episodes = []
    begun = starts(target, every)
    for start in begun[:1] if loop.rules.to_end else begun:
        if episode := draft.known(target.id, start):
            episodes.append(episode)
            continue
        known = windows.get((target.id, start), ())
        outcome = run(replace(loop, cue=cue(start)), target, start, known)
        windows[target.id, start] = outcome.windows
        if outcome.iou:
            episodes.append(told(outcome, target))
            draft.add(target.id, episodes[-1])
    return {"target": target.id, "kind": target.kind, "episodes": episodes}


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
def warnings_into(path: Path, name: str) -> Iterator[None]:
    """Write the stages' warnings into a file, because they would break the bar on the terminal."""
    handler = logging.FileHandler(path, delay=True)
    handler.setFormatter(logging.Formatter(f"{name}: %(message)s"))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()
