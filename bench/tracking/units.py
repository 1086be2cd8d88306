"""Units of work of an evaluation (cases x clips), each written when it is done."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from bench.tracking.budgets import PLANNED
from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName
from bench.tracking.job import Work, follow, same_windows
from bench.tracking.key import key, unit_files
from bench.tracking.pooled import write_units
from bench.tracking.store import Unit, forget_damaged, units

# measured; 1 is a row whose windows are known or need no network
COST = {"temporal": 0.2, "exposure": 2.0, **dict.fromkeys(PLANNED, 2.0)}


def measured(
    clips: Sequence[ClipName],
    cases: Sequence[Case],
    protocol: Protocol,
    folder: Path,
    *,
    jobs: int,
) -> list[Unit]:
    """Return all units: the finished ones from the folder, the others after measuring them."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = [key(case, protocol) for case in cases]
    files = {clip: unit_files(folder, clip, protocol.frames, keys) for clip in clips}
    paths = [path for found in files.values() for path in found]
    forget_damaged(paths)
    left = {
        clip: [work for work in zip(cases, found, strict=True) if not work[1].exists()]
        for clip, found in files.items()
    }
    jobs_left = [partial(follow, clip, work, protocol) for clip, work in cut(left, jobs)]
    write_units(jobs_left, paths, folder, jobs=jobs)
    return [unit for path in paths for unit in units(path)]


def cut(
    left: Mapping[ClipName, Sequence[Work]], jobs: int
) -> list[tuple[ClipName, tuple[Work, ...]]]:
    """Return the work of each job: a clip, or a part of one if processes would be idle otherwise.

    Each part reads the clip again and needs memory for it.
    """
    clips = [clip for clip, work in left.items() if work]
    rest = len(clips) % jobs
    whole, last = clips[: len(clips) - rest], clips[len(clips) - rest :]
    parts = [(clip, part) for clip in last for part in _parts(left[clip], jobs // rest)]
    return [*((clip, tuple(left[clip])) for clip in whole), *parts]


def _parts(work: Sequence[Work], count: int) -> list[tuple[Work, ...]]:
    """Return at most `count` parts of about equal cost.

    Rows with the same windows stay together. Rows of a budget are adjacent, so that the detector
    runs on its contexts once, or twice if they are divided between two parts.
    """
    groups: dict[Case, list[Work]] = {}
    for each in sorted(work, key=lambda w: (w[0].budget, "detections" in w[0].replaced)):
        groups.setdefault(same_windows(each[0]), []).append(each)
    costs = [COST.get(case.strategy, 1.0) + len(same) - 1 for case, same in groups.items()]
    parts: list[list[Work]] = [[] for _ in range(count)]
    before = 0.0
    for cost, same in zip(costs, groups.values(), strict=True):
        parts[int((before + cost / 2) / sum(costs) * count)] += same
        before += cost
    return [tuple(part) for part in parts if part]
