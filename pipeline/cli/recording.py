"""`fovea record | replay`: outputs of a graph to an MCAP file, and a graph on such a file."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from pipeline import output, signals, terminal
from pipeline.cli.arguments import DURATION_S, FRAMES, Finite
from pipeline.cli.files import try_recording, try_report, write_report
from pipeline.cli.light import compared, table
from pipeline.cli.overlaid import load_overlaid, overlaid
from pipeline.client import recording as recorder
from pipeline.client.find import find
from pipeline.client.local import LocalGraph
from pipeline.errors import RunError, SettingsError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.shipped import graph_path
from pipeline.protocol.fleet import EdgeState
from pipeline.recording.reader import Recording
from pipeline.run.replay import OwnPace, Replayed, plan_in, record_inline, replay
from pipeline.text import harmless

DIFFERENT = 1  # exit status of --verify when a message differs
PACE = click.Choice(["flat", "own", "step"])
LOST = {  # what a recorder counts -> in words
    "dropped": "not written: the disk is slow or full", "refused": "could not be encoded",
    "passed": "passed through the ring",
}  # fmt: skip
LIMIT_MB, LIMIT_S = Finite(0.1, 1e9), Finite(0.1, 1e9)


@click.command("record")
@click.argument("graph")
@click.option("--out", type=click.Path(path_type=Path), help="The file; default: GRAPH.mcap.")
@click.option("--edges", multiple=True, metavar="NODE[.OUTPUT]", help="Default: all that are read.")
@click.option("--duration-s", type=DURATION_S, help="Stop after this time.")
@click.option("--file-mb", type=LIMIT_MB, help="Begin a new file at this size.")
@click.option("--file-s", type=LIMIT_S, help="Begin a new file after this time.")
@click.option("--ring-s", type=LIMIT_S, help="Keep the last seconds in memory; write when told.")
@click.option("--compression", type=click.Choice(["zstd", "lz4", "none"]), help="Default: zstd.")
@click.option("--inline", is_flag=True, help="Run GRAPH in this thread, and record all of it.")
@click.option("--frames", type=FRAMES, help="With --inline: stop after this many exposures.")
@overlaid
def record_command(
    graph: str, out: Path | None, edges: tuple[str, ...], duration_s: float | None,
    file_mb: float | None, file_s: float | None, ring_s: float | None, compression: str | None,
    inline: bool, frames: int | None, **laid: Any,
) -> None:  # fmt: skip
    """Record outputs of a running graph to an MCAP file, until it ends or Ctrl-C."""
    path = out or Path(f"{Path(graph).stem}.mcap")
    try_recording(path, "--out")
    if path.exists() or path.is_symlink():
        got = "one that exists" if path.exists() else "a link"
        raise SettingsError(f"--out {path}: expected a new file, got {got}")
    if inline:
        if edges or duration_s or file_mb or file_s or ring_s or compression:
            raise click.UsageError(
                "--inline records every output to one file; limit it by --frames"
            )
        _record_inline(graph, path, frames or 0, laid)
        return
    if frames or any(laid.values()):
        raise click.UsageError("--frames, --source, --set, --clock, --with: they go with --inline")
    client = find(graph)
    if not isinstance(client, LocalGraph):
        raise RunError(
            f"{graph}: expected a graph of this host, got one of several hosts; there a node of "
            f"the graph records: {recorder.OPERATOR}"
        )
    given = {"file_mb": file_mb, "file_s": file_s, "ring_s": ring_s, "compression": compression}
    with signals.Interruption() as asked:
        what = recorder.chosen(client, edges)
        values = {name: value for name, value in given.items() if value}
        with recorder.begun(client, path, what, values) as before:
            click.echo(f"{graph}: recording {len(what.inputs)} outputs to {path}; Ctrl-C ends it")
            found = recorder.follow(client, path, duration_s or 0.0, asked.asked, _line(), before)
    _print_counts(found)
    _print_files([Path(file) for file in found.files])
    if found.removed:
        click.echo(f"{graph}: the recording ended: its recorder was removed from the graph")
    if found.failure:
        raise RunError(_incomplete(client, found.failure))


@click.command("replay")
@click.argument("file", type=click.Path(path_type=Path))
@click.argument("graph", required=False, type=GRAPH_FILE)
@click.option("--nodes", multiple=True, metavar="NODE", help="Replace this node, too.")
@click.option("--verify", is_flag=True, help="Compare with what was recorded, bit for bit.")
@click.option("--frames", type=FRAMES, help="Stop after this many frames.")
@click.option("--pace", type=PACE, default="flat", help="Flat out, as recorded, or by Enter.")
@click.option("--light", is_flag=True, help="Its full frames are what the sensor of GRAPH sees.")
@click.option("--try", "tries", multiple=True, metavar="'NODE.SETTING=VALUE …'",
              help="With --light: run with these changes; several are compared.")  # fmt: skip
@click.option(
    "--save",
    type=click.Path(path_type=Path),
    help="Write a Rerun recording; with --light the tries side by side.",
)
@click.option("--report", type=click.Path(path_type=Path), help="Write the report as JSON.")
@overlaid
def replay_command(
    file: Path, graph: Path | None, nodes: tuple[str, ...], verify: bool, frames: int | None,
    pace: str, light: bool, tries: tuple[str, ...], save: Path | None, report: Path | None,
    **laid: Any,
) -> None:  # fmt: skip
    """Run a graph on a recording in place of its source, in lockstep.

    Without GRAPH, the one that the recording holds: its code runs here, as with `fovea run`.
    """
    if light:
        if nodes or verify or report or laid["source"] or graph is None:
            raise click.UsageError(
                "--light: expected FILE GRAPH, --try, --set, --with, --frames, --save"
            )
        _on_its_light(file, graph, tries, frames or 0, laid, save)
        return
    if tries:
        raise click.UsageError("--try: goes with --light")
    if report:
        try_report(report, "--report")
    if save:
        try_recording(save, "--save")
    recording = Recording(file)
    if recording.broken:
        output.complain(f"fovea: {file}: {recording.broken}")
    if graph is None:
        if save or any(laid.values()):
            raise click.UsageError("--save, --source, --set, --clock, --with: they need GRAPH")
        plan = plan_in(recording)
    else:
        plan = load_overlaid(graph, save=save, **{**laid, "clock": "lockstep"})
    with signals.Interruption(last=True) as asked:
        step = _pace(pace, recording, asked.asked)
        found = replay(plan, recording, nodes=nodes, frames=frames or 0, verify=verify, step=step)
    _print_replayed(plan.name, found, verify=verify)
    unwritten = write_report(report, dict(found.report), "--report") if report else ""
    if unwritten:
        raise RunError(unwritten)
    if status := asked.status or (DIFFERENT if found.different else 0):
        sys.exit(status)
    if verify and not found.compared:
        raise RunError(f"{file}: cannot be verified: expected a message to compare, got none")


def _on_its_light(
    file: Path, graph: Path, tries: tuple[str, ...], frames: int, laid: dict[str, Any],
    save: Path | None,
) -> None:  # fmt: skip
    if save:
        try_recording(save, "--save")
    with signals.Interruption(last=True) as asked:
        reports = compared(file, graph, tries, frames, asked.asked, laid, save)
    terminal.console().print(table(reports))
    if asked.status:
        sys.exit(asked.status)


def _record_inline(graph: str, path: Path, frames: int, laid: dict[str, Any]) -> None:
    plan = load_overlaid(graph_path(graph), **{**laid, "clock": "lockstep"})
    with signals.Interruption() as asked:
        figures = record_inline(plan, path, frames, asked.asked)
    for name, one in figures.items():
        click.echo(f"{name.removesuffix('.out')}: {one['recorded']} messages")
    _print_files([path])


def _pace(pace: str, recording: Recording, asked: Callable[[], int]) -> Callable[[int, int], bool]:
    if pace == "own":
        return OwnPace(recording, asked)

    def stepped(seq: int, _log_ns: int) -> bool:
        if pace == "step":
            click.echo(f"frame {seq}; Enter: the next one, q: end ", nl=False)
            line = sys.stdin.readline()
            return bool(line) and line.strip() != "q" and not asked()
        return not asked()

    return stepped


def _print_replayed(name: str, found: Replayed, *, verify: bool) -> None:
    speed = f", {found.recorded_s / found.duration_s:.2f} times the speed it was recorded at"
    click.echo(
        f"{name}: {found.frames} frames in {found.duration_s:.1f} s"
        + (speed if found.duration_s and found.recorded_s > 0 else "")
    )
    if not verify:
        return
    if found.first is not None:
        click.echo(f"first difference: {harmless(str(found.first))}")
        click.echo(f"{found.different} of {found.compared} messages differ or are missing")
    elif found.compared:
        click.echo(f"verified: {found.compared} messages, equal bit for bit")
    if found.outside:
        told = "the file begins or ends in the middle of their exposures"
        click.echo(f"left out: {found.outside} messages; {told}")
    if found.unrecorded:
        click.echo(f"not recorded, and so not compared: {', '.join(found.unrecorded)}")


def _line() -> Callable[[list[EdgeState]], None]:
    """Return a function that shows the progress on a terminal."""
    console = terminal.console()

    def show(accounts: list[EdgeState]) -> None:
        if console.is_terminal and accounts:
            done = sum(edge.account["delivered"] for edge in accounts)
            console.print(f"{done} messages", end="\r", markup=False)

    return show


def _incomplete(client: LocalGraph, failure: str) -> str:
    """Return what became of the graph, which may have been killed, and of its recording."""
    graph = "goes on" if client.runs() else "has ended"
    return f"{client.name}: {graph}; the recording is incomplete: {failure}"


def _print_counts(found: recorder.Outcome) -> None:
    """Print by output how many messages the files have, and what was lost on the way there."""
    edges = {e.origin if "." in e.origin else f"{e.origin}.out": e.account for e in found.accounts}
    for name in dict.fromkeys([*edges, *found.outputs]):
        account = edges.get(name, {"delivered": 0, "dropped": {}})  # it was removed before a look
        counts = found.outputs.get(name, {"recorded": account["delivered"]})
        lost = {cause: n for cause, n in account["dropped"].items() if n} | {
            words: counts[count] for count, words in LOST.items() if counts.get(count)
        }
        told = ", ".join(f"{n} {cause}" for cause, n in lost.items())
        told = f"{counts['recorded']} messages" + (f"; {told}" if told else "")
        click.echo(f"{name.removesuffix('.out')}: {told}")


def _print_files(files: list[Path]) -> None:
    for file in files:
        if file.exists():
            click.echo(f"recording: {file}, {file.stat().st_size / 1e6:.1f} MB")
