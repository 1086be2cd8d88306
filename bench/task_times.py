"""Run time by task: `python -m bench.task_times REPORT … --out FILE`, reports of `bench.loop`.

Puts what each stage of several graphs takes per message, and how long the loop is from picture to
command, into one table beside the paper's times of its parts.
"""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from bench.options import Bench
from bench.run_time import PAPER_MS, TOTAL
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

STAGES = ("saliency", "association", "roi_features", "policy", "dispatch")
CONSUMERS = ("tracker", "reader", "manipulation")
LOOP = {"latency": "picture → command", "overhead": "of it beyond the handlers"}
NONE = "–"


class Spread(msgspec.Struct, frozen=True):
    """Median, least and greatest value over rounds."""

    median: float
    min: float
    max: float


class Summary(msgspec.Struct, frozen=True):
    """What is read of a report: figures by stage and of the loop."""

    loop: dict[str, Spread]
    stages: dict[str, dict[str, Spread]]


class LoopReport(msgspec.Struct, frozen=True):
    """A report of `bench.loop`."""

    graph: str
    frames: int
    commit: str
    machine: dict[str, Any]
    summary: Summary
    rounds: list[dict[str, Any]]


@click.command(cls=Bench, help=__doc__)
@click.argument("reports", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="result file")
def main(reports: tuple[Path, ...], out: Path) -> None:
    """Write the table."""
    found = {path.name: read_report(path) for path in reports}
    write_whole(out, json.dumps(table_of(found), indent=1, ensure_ascii=False) + os.linesep)
    click.echo(f"{out}: {len(found)} tasks")


def read_report(path: Path) -> LoopReport:
    """Return a report; raises `SettingsError` for another file."""
    try:
        found = msgspec.json.decode(path.read_bytes(), type=LoopReport)
    except (OSError, msgspec.MsgspecError) as error:
        raise SettingsError(f"{path}: expected a report of bench.loop: {error}") from error
    keys = {f"{name}_ms_{share}" for name in LOOP for share in ("p50", "p99")}
    if not keys <= found.summary.loop.keys():
        raise SettingsError(f"{path}: expected a report of bench.loop with {', '.join(keys)}")
    return found


def table_of(reports: Mapping[str, LoopReport]) -> dict[str, Any]:
    """Return the result file: a row a task, milliseconds per message in each stage."""
    rows: list[list[str]] = [_row(report) for report in reports.values()]
    paper = [PAPER_MS.get(stage) for stage in STAGES]
    told = [NONE if ms is None else f"{ms:g}" for ms in paper]
    rows.append(["the paper's parts, i7-7700HQ", *told, NONE, f"{PAPER_MS[TOTAL]:g}", NONE])
    return {
        "id": "task_times",
        "section": "Time of each part",
        "order": 8,
        "title": "Run time by task, ms: stages at the median of messages; the loop p50 / p99",
        "source": ", ".join(reports),
        "command": "python -m bench.loop GRAPH --json REPORT, then bench.task_times REPORT …",
        "data": "the graphs as they ship, in real time, a process a stage; simulated sensors",
        "machine": _machines(list(reports.values())),
        "commit": ", ".join(dict.fromkeys(report.commit[:7] for report in reports.values())),
        "n": "; ".join(
            f"{report.graph}: {len(report.rounds)} x {report.frames} frames"
            for report in reports.values()
        ),
        "spread": "median of the rounds, least to greatest in brackets",
        "reference": "the paper's table of run time; its total is the sum of its parts",
        "columns": ["graph", *STAGES, "consumer", *LOOP.values()],
        "rows": rows,
    }


def _row(report: LoopReport) -> list[str]:
    stages, loop = report.summary.stages, report.summary.loop
    consumer = next((name for name in CONSUMERS if name in stages), "")
    times = [_time(stages.get(name, {}).get("handler_p50_ms")) for name in (*STAGES, consumer)]
    both = [f"{_time(loop[f'{name}_ms_p50'])} / {_time(loop[f'{name}_ms_p99'])}" for name in LOOP]
    return [Path(report.graph).stem, *times, *both]


def _time(seen: Spread | None) -> str:
    """Return a time with its range.

    >>> _time(Spread(2.04, 1.9, 2.26)), _time(None)
    ('2.0 (1.9–2.3)', '–')
    """
    return NONE if seen is None else f"{seen.median:.1f} ({seen.min:.1f}–{seen.max:.1f})"


def _machines(reports: Sequence[LoopReport]) -> str:
    said = (
        f"{report.machine.get('cpu')}, {report.machine.get('cores')} cores, load "
        f"{report.machine.get('load_1min')}"
        for report in reports
    )
    return "; ".join(dict.fromkeys(said))


if __name__ == "__main__":
    main()
