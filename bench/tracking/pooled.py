"""Jobs in worker processes that write units, and a bar that counts them: calls in, files out."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
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

from operators.training.workers import pool_of

LOOK_S = 1.0  # between counts of finished units
WARNINGS = "warnings.log"  # of the stages, beside the units


def write_units(
    calls: Iterable[Callable[[Path], None]], paths: Sequence[Path], folder: Path, *, jobs: int
) -> None:
    """Call what writes the missing ones of `paths`, in `jobs` processes.

    Each call gets the file that takes its warnings. How many there were is told at the end.
    """
    warnings_file = folder / WARNINGS
    before = _lines(warnings_file)
    with pool_of(jobs) as pool, _progress() as bar:
        task = bar.add_task("units", total=len(paths), completed=_finished(paths))
        waiting = {pool.submit(call, warnings_file) for call in calls}
        while waiting:
            done, waiting = wait(waiting, timeout=LOOK_S, return_when=FIRST_EXCEPTION)
            for job in done:
                job.result()
            bar.update(task, completed=_finished(paths))
    if more := _lines(warnings_file) - before:
        click.echo(f"{more} warnings: {warnings_file}", err=True)


def _progress() -> Progress:
    name = TextColumn("{task.description}")
    columns = (name, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True))


def _finished(paths: Iterable[Path]) -> int:
    return sum(path.exists() for path in paths)


def _lines(path: Path) -> int:
    return path.read_text().count("\n") if path.exists() else 0
