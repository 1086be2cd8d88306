"""`fovea doctor [GRAPH]`: print a line per check; exit status 1 when something is wrong."""

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

import click
from rich.text import Text

from pipeline import terminal
from pipeline.doctor.finding import Finding
from pipeline.doctor.installation import examine_installation
from pipeline.doctor.machine import examine_machine
from pipeline.doctor.needs import examine_graph
from pipeline.errors import InstallError
from pipeline.file_arguments import GRAPH_FILE, SOURCE_FILE
from pipeline.graph.overlay import Overlay
from pipeline.import_path import imported
from pipeline.renamed import renamed_option
from pipeline.run.leftovers import cleanup

SENSORS = "drivers.attached.diagnosis:examine_sensors"  # by its path: it knows the drivers
STYLES = {"ok": "green", "warning": "yellow", "wrong": "bold red"}


@click.command("doctor")
@click.argument("graph", required=False, type=GRAPH_FILE)
@click.option("--source", type=SOURCE_FILE, help="Source of frames: a shipped one or a file.")
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@click.option("--no-trial", is_flag=True, help="Do not send a frame through the graph.")
@click.option("--cleanup", "clean", is_flag=True, help="First remove leftovers of killed runs.")
@renamed_option("--sweep", "--cleanup", flag=True)
@click.option("--json", "as_json", is_flag=True, help="One object per finding.")
def doctor_command(
    graph: Path | None, source: Path | None, changes: tuple[str, ...], no_trial: bool,
    clean: bool, as_json: bool,
) -> None:  # fmt: skip
    """Diagnose this installation, or a graph on it, and suggest remedies."""
    if clean:
        cleanup()
    overlay = Overlay(source=source, changes=changes)
    found = list(told(examine(graph, overlay, trial=not no_trial), quiet=as_json))
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in found], indent=1))
    if any(finding.verdict == "wrong" for finding in found):
        sys.exit(1)


def examine(graph: Path | None, overlay: Overlay, *, trial: bool) -> Iterator[Finding]:
    """Yield all findings, those of the machine first."""
    yield from examine_machine()
    yield from examine_installation()
    yield from imported(SENSORS, InstallError)()
    if graph is not None:
        yield from examine_graph(graph, overlay, trial=trial)


def told(findings: Iterable[Finding], *, quiet: bool) -> Iterator[Finding]:
    """Yield the same findings, and print each as it comes."""
    console = terminal.console(soft_wrap=True, highlight=False)
    for finding in findings:
        if not quiet:
            console.print(line(finding))
        yield finding


def line(finding: Finding) -> Text:
    """Return a finding as the terminal shows it.

    >>> line(Finding(what="disk", verdict="wrong", why="full", todo="make room")).plain
    'wrong    disk            full -> make room'
    """
    verdict = (f"{finding.verdict:<9}", STYLES[finding.verdict])
    todo = f" -> {finding.todo}" if finding.todo else ""
    return Text.assemble(verdict, f"{finding.what:<16}{finding.why}", (todo, "bold"))
