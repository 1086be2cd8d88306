"""A graph file with what the command line lays over it: options, and the checked plan."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from pipeline.errors import GraphError
from pipeline.file_arguments import GRAPH_FILE, SOURCE_FILE
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, manual_nodes, read_settings
from pipeline.graph.plan import Plan

GRAPH = click.argument("graph", type=GRAPH_FILE)


def overlaid(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that overlay a graph file."""
    for option in (
        click.option(
            "--source", type=SOURCE_FILE, help="Source of frames: a shipped one or a file."
        ),
        click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE"),
        click.option(
            "--settings", type=click.Path(path_type=Path, dir_okay=False),
            help="YAML of settings by node, as `fovea tune` writes it.",
        ),
        click.option("--clock", type=click.Choice(["realtime", "lockstep"])),
        click.option("--with", "wanted", multiple=True, metavar="NODE", help="Manual node to run."),
    ):  # fmt: skip
        command = option(command)
    return command


def load_overlaid(
    graph: Path, *, save: Path | None = None, source: Path | None, changes: tuple[str, ...],
    clock: str | None, wanted: tuple[str, ...], settings: Path | None = None,
) -> Plan:  # fmt: skip
    """Return the plan of a file and its overlays; raises `FoveaError` with file and line."""
    values = tuple(read_settings(settings)) if settings else ()
    if save:
        viewer = manual_nodes(graph, "save")
        if not viewer:
            raise GraphError(f"{graph}: --save needs a node with a setting `save`, got none")
        wanted = (*wanted, viewer[0])
        values = (*values, (viewer[0], "save", str(save)))
    return load(graph, Overlay(source, changes, clock or "", wanted, values))
