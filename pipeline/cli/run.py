"""`fovea run`: load a graph file with overlays, and run it."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from pipeline import output, signals, terminal
from pipeline.cli import running
from pipeline.cli.arguments import DURATION_S, FRAMES, print_json
from pipeline.cli.detached import DetachedRun, start
from pipeline.cli.files import try_recording, try_report, write_report
from pipeline.cli.overlaid import GRAPH, load_overlaid, overlaid
from pipeline.client.detached import WORDS
from pipeline.contract import INCOMPLETE
from pipeline.run.reaper import Reaper
from pipeline.run.report import Report, print_report
from pipeline.run.rundir import folder_of
from pipeline.run.verdict import crashed
from pipeline.text import harmless

CRASHED = 3  # exit status of a run that completed although processes crashed
console = terminal.console()


@click.command()
@GRAPH
@overlaid
@click.option("--inline", is_flag=True, help="One thread, no processes, in lockstep.")
@click.option("--frames", type=FRAMES, help="Stop after this many exposures.")
@click.option("--duration-s", type=DURATION_S, help="Stop after this time.")
@click.option("--save", type=click.Path(path_type=Path), help="Write a Rerun recording.")
@click.option("--report", type=click.Path(path_type=Path), help="Write the report as JSON.")
@click.option("--verbose", is_flag=True, help="Print every edge and stage below the verdict.")
@click.option(
    "--heartbeat", type=click.Path(path_type=Path, dir_okay=False),
    help="Renew this file while it runs, for a watchdog.",
)  # fmt: skip
@click.option("--detach", is_flag=True, help="Return once it runs; `fovea stop` stops it.")
@click.option("--json", "as_json", is_flag=True, help="With --detach: print JSON.")
@click.option("--detached", type=int, hidden=True)
def run(detach: bool, as_json: bool, detached: int | None, **given: Any) -> None:
    """Run a graph until its source ends, a limit or Ctrl-C."""
    if given["frames"] and given["duration_s"]:
        raise click.UsageError("--frames and --duration-s: give one of them")
    if given["inline"] and (given["clock"] == "realtime" or given["duration_s"]):
        raise click.UsageError("--inline runs in lockstep: limit it by --frames")
    if detach and given["inline"]:
        raise click.UsageError("--detach and --inline: give one of them")
    if given["heartbeat"] and given["inline"]:
        raise click.UsageError("--heartbeat: goes with processes, not with --inline")
    if as_json and not detach:
        raise click.UsageError("--json: goes with --detach; `--report FILE` writes the report")
    if detach:
        _detach(given, as_json=as_json)
        return
    own = DetachedRun(detached) if detached is not None else None
    if own is None:
        status = _run(**given)
    else:
        with own.noting() as note:
            status = _run(when_it_runs=own.leave, note=note, **given)
    if status:
        sys.exit(status)


def _run(
    *, graph: Path, inline: bool, frames: int | None, duration_s: float | None,
    save: Path | None, report: Path | None, verbose: bool, heartbeat: Path | None,
    when_it_runs: Callable[[str], None] | None = None,
    note: Callable[[int, str, Report], None] = lambda *_: None, **laid: Any,
) -> int:  # fmt: skip
    """Run in this process; return the exit status."""
    if inline:
        laid["clock"] = "lockstep"
    if report:
        try_report(report, "--report")
    if heartbeat:
        try_recording(heartbeat, "--heartbeat")
    if save:
        try_recording(save, "--save")
    plan, unwritten = load_overlaid(graph, save=save, **laid), ""
    for line in running.advice(plan):
        console.print(line, markup=False, soft_wrap=not console.is_terminal)
    with signals.Interruption(last=True) as asked:
        if inline:
            result = running.inline(plan, frames or 0, console, asked, verbose=verbose)
        else:
            result = running.processes(
                plan,
                frames or 0,
                duration_s or 0.0,
                console,
                asked,
                Reaper(),
                when_it_runs,
                heartbeat,
            )
        if report:
            unwritten = write_report(report, result, "--report")
        print_report(console, result, verbose=verbose)
        if unwritten:
            click.echo(json.dumps(result, indent=1))
        if save:
            console.print(f"recording: {save}, open it with: rerun {save}", markup=False)
    wrong = [why for why in (result.get("failure"), result.get(INCOMPLETE), unwritten) if why]
    for why in wrong:
        output.complain(f"Error: {harmless(str(why))}")
    status = asked.status or (2 if wrong else 0)
    if not status and (said := crashed(result)):
        wrong = [f"{plan.name} ran to its end, but {harmless(said)}"]
        output.complain(f"Error: {wrong[0]}")
        status = CRASHED
    note(status, harmless("; ".join(map(str, wrong))), result)
    return status


def _detach(given: Mapping[str, Any], *, as_json: bool) -> None:
    options = {
        "--source": given["source"], "--clock": given["clock"], "--frames": given["frames"],
        "--duration-s": given["duration_s"], "--save": given["save"], "--report": given["report"],
        "--settings": given["settings"], "--heartbeat": given["heartbeat"],
    }  # fmt: skip
    words = [f"{name}={value}" for name, value in options.items() if value is not None]
    words += [f"--set={change}" for change in given["changes"]]
    words += [f"--with={node}" for node in given["wanted"]]
    words += ["--verbose"] if given["verbose"] else []
    graph, pid = start([*words, "--", str(given["graph"])])
    file = folder_of(graph) / WORDS
    if as_json:
        print_json({"graph": graph, "pid": pid, "words": str(file)})
        return
    click.echo(
        f"{graph}: runs, process {pid}, prints to {file}\n"
        f"look at it: fovea attach {graph}; end it: fovea stop {graph}"
    )
