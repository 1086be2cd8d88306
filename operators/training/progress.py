"""Progress display of a training: "phase 1 of 3: record clips", with a bar per phase.

In a pipe there are no bars: each phase is announced, and the training's log.csv has the rest.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from pipeline import terminal

T = TypeVar("T")


@dataclass(frozen=True)
class Bar:
    """How far a phase has come."""

    progress: Progress
    task: TaskID

    def step(self, words: str = "") -> None:
        """One step more, with figures of now."""
        self.progress.update(self.task, advance=1, words=words)


@contextmanager
def bar(name: str, total: int | None, done: int = 0) -> Iterator[Bar]:
    """A bar on standard error, from `done` on; what is printed meanwhile stands above it."""
    console = terminal.console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[words]}", markup=False),
    )
    if not console.is_terminal:
        console.print(name, markup=False, highlight=False, soft_wrap=True)
    shown = Progress(
        *columns, console=console, disable=not console.is_terminal,
        redirect_stdout=sys.stdout.isatty(), redirect_stderr=sys.stderr.isatty(),
    )  # fmt: skip
    with shown:
        yield Bar(shown, shown.add_task(name, total=total, completed=done, words=""))


def tracked(items: Sequence[T], name: str) -> Iterator[T]:
    """The items with a bar; nothing is shown where there are none."""
    if items:
        yield from each_of(items, name, len(items))


def each_of(items: Iterable[T], name: str, total: int | None = None) -> Iterator[T]:
    """The items with a bar, which moves to and fro where their number is not known."""
    with bar(name, total) as shown:
        for item in items:
            yield item
            shown.step()


@dataclass(frozen=True)
class Phases:
    """The phases of a training by name, in their order.

    >>> Phases("record clips", "train")["train"]
    'phase 2 of 2: train'
    """

    names: tuple[str, ...]

    def __init__(self, *names: str) -> None:
        object.__setattr__(self, "names", names)

    def __getitem__(self, name: str) -> str:
        """The line that announces a phase."""
        return f"phase {self.names.index(name) + 1} of {len(self.names)}: {name}"
