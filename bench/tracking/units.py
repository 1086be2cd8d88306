"""Units of work of an evaluation (cases x clips), each written when it is done."""

from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from hashlib import sha256
from pathlib import Path

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from bench.tracking.budgets import PLANNED
from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName
from bench.tracking.job import Work, follow, same_windows
from bench.tracking.key import clip_key, key
from bench.tracking.store import Unit, forget_damaged, units
from operators.training.workers import pool_of

LOOK_S = 1.0  # between counts of finished units
WARNINGS = "warnings.log"  # of the stages, beside the units
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
    places = {clip: _places(folder, clip, protocol, keys) for clip in clips}
    paths = [path for found in places.values() for path in found]
    forget_damaged(paths)
    left = {
        clip: [work for work in zip(cases, found, strict=True) if not work[1].exists()]
        for clip, found in places.items()
    }
    warnings_file = folder / WARNINGS
    before = _lines(warnings_file)
    finished = sum(path.exists() for path in paths)
    with pool_of(jobs) as pool, _progress() as bar:
        task = bar.add_task("units", total=len(paths), completed=finished)
        waiting = {
            pool.submit(follow, clip, work, protocol, warnings_file)
            for clip, work in cut(left, jobs)
        }
        while waiting:
            done, waiting = wait(waiting, timeout=LOOK_S, return_when=FIRST_EXCEPTION)
            for job in done:
                job.result()
            bar.update(task, completed=sum(path.exists() for path in paths))
    if more := _lines(warnings_file) - before:
        click.echo(f"{more} warnings: {warnings_file}", err=True)
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


def _progress() -> Progress:
    name = TextColumn("{task.description}")
    columns = (name, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True))


def _places(folder: Path, clip: ClipName, protocol: Protocol, keys: Sequence[str]) -> list[Path]:
    """Return the files of a clip's units."""
    content = clip_key(clip, protocol.frames)
    digests = [sha256(f"{key} {content}".encode()).hexdigest() for key in keys]
    return [folder / f"{clip}-{digest[:16]}.json" for digest in digests]


def _lines(path: Path) -> int:
    return path.read_text().count("\n") if path.exists() else 0
