"""Options and error handling shared by benches that run a graph."""

import argparse
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from pipeline.errors import FoveaError
from pipeline.file_arguments import GRAPH_FILE, SOURCE_FILE

ROOT = Path(__file__).resolve().parents[1]
MOST_CLIPS = 1000  # of an evaluation: days of work, and hundreds of bytes of memory each


def writable(_: click.Context, option: click.Parameter, path: Path | None) -> Path | None:
    """Return a file that can be written, its folder made: hours of work come before it."""
    if path is not None and (why := _unwritable(path)):
        raise click.BadParameter(why, param=option)
    return path


def new_file(text: str) -> Path:
    """Return a file as `writable` does, for argparse."""
    if why := _unwritable(Path(text)):
        raise argparse.ArgumentTypeError(why)
    return Path(text)


def _unwritable(path: Path) -> str:
    """Make the folder of a file; return why the file cannot be written, empty if it can."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return f"{path.parent}: cannot be a folder: {error.strerror}"
    place = path if path.exists() else path.parent
    special = path.exists() and not path.is_file()  # a file is replaced by a whole one
    return f"{path}: cannot be written" if special or not os.access(place, os.W_OK) else ""


JSON = click.option(
    "--json", "path", type=click.Path(path_type=Path), callback=writable, help="Write the figures."
)


class Bench(click.Command):
    """A command that prints a `FoveaError` as one sentence and exits with status 1."""

    def make_context(self, *given: Any, **named: Any) -> click.Context:
        """Read the arguments, of which some name graphs."""
        try:
            return super().make_context(*given, **named)
        except FoveaError as error:
            raise click.ClickException(str(error)) from error

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except FoveaError as error:
            raise click.ClickException(str(error)) from error


def file_name(path: Path) -> str:
    """Return the name of a file for a report: below the repository its path there, else its name.

    >>> file_name(ROOT / "graphs/tracking.yaml"), file_name(Path("/somewhere/graph.yaml"))
    ('graphs/tracking.yaml', 'graph.yaml')
    """
    found = path.resolve()
    return found.relative_to(ROOT).as_posix() if found.is_relative_to(ROOT) else found.name


def told_changes(changes: Iterable[str]) -> list[str]:
    """Return each NODE.SETTING=VALUE for a report: of a path what `file_name` makes of it.

    >>> told_changes(["capture.path=/somewhere/SNMOT-116a", "capture.seed=7"])
    ['capture.path=SNMOT-116a', 'capture.seed=7']
    """
    parted = [change.partition("=") for change in changes]
    return [
        f"{setting}={file_name(Path(value)) if Path(value).is_absolute() else value}"
        for setting, _, value in parted
    ]


def graph_option(default: Path) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option `--graph`, found as by `fovea run`; the command receives its path as text.

    Raises `GraphError` for an unknown name while the command line is read.
    """
    return click.option(
        "--graph", type=GRAPH_FILE, default=default, help="the loop: a shipped graph or a file",
        callback=lambda _context, _option, path: str(path),
    )  # fmt: skip


def on_graph(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add options for the graph to run (`graph`) and what is laid over it (`source`, `changes`)."""
    for decorate in (
        click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE"),
        click.option(
            "--source", type=SOURCE_FILE, help="Source of frames: a shipped one or a file."
        ),
        click.argument("graph", default="tracking", type=GRAPH_FILE),
    ):
        command = decorate(command)
    return command
