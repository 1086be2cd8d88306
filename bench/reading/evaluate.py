"""`fovea eval text`: how many texts of a street a frozen reader reads, by strategy and budget.

A clip is the graph in lockstep over the road of a seed. An instance that is legible in at least one
frame at full resolution is transcribed if the reader says it correctly at its place in at least one
frame. All rows have the same clips and the same reader. Seeds of 0 to 9,999 are for training,
50,000 to 59,999 for development, 70,000 to 79,999 for tables.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from fractions import Fraction
from functools import cache
from hashlib import sha256
from math import ceil, isnan
from pathlib import Path
from statistics import median
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from bench.machine import facts
from bench.options import MOST_CLIPS, Bench, graph_option
from bench.outputs import STANDARD_OUTPUT, make_room, work_folder
from bench.reading.clips import ROAD, clips_of
from bench.reading.plot import plot
from bench.reading.rows import EXPOSURE, FOVEATED, FULL, INPUTS, PARTS, Row, rows_of
from bench.reading.trial import Job, Outcome, plan_of, size_of, trial
from bench.tracking.budgets import parsed
from bench.tracking.intervals import METHOD, Block, difference, mean
from operators.training.identity import of_code, of_plan
from operators.training.progress import bar
from operators.training.workers import pool_of
from pipeline.errors import SettingsError
from pipeline.fleet.placement import file_digest
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.terminal import lean_table
from pipeline.whole_file import write_whole

GRAPH = Path(__file__).parents[2] / "graphs" / "text.yaml"
LIBRARIES = ("numpy", "onnxruntime", "opencv-python-headless", "rapidocr", "pillow")
CODE = (
    *("drivers.scenes.road", "drivers.datasets", "drivers.simulated"),
    *("operators.transcribed", "bench.reading.trial"),
)
MOST_FRAMES = 100_000
PAPER = {  # Table 1 and the budget sweep: transcription rate on RoadText-1K
    (FULL, "1"): 0.333, ("oracle", "1/8"): 0.271,
    **{("spatial", b): v for b, v in (("1/4", 0.146), ("1/8", 0.067), ("1/16", 0.023))},
    **{("temporal", b): v for b, v in (("1/4", 0.283), ("1/8", 0.248), ("1/16", 0.173))},
    **{("foveated", b): v for b, v in (("1/4", 0.290), ("1/8", 0.264), ("1/16", 0.227))},
    ("exposure", "1/8"): 0.071, ("centred", "1/8"): 0.012, ("round_robin", "1/8"): 0.213,
}  # fmt: skip
HEAD = [
    "strategy", "budget", "read", "95 %", "but one edit", "per s", "wait s", "share of full",
    "to foveated", "paper",
]  # fmt: skip


@click.command(
    cls=Bench,
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--strategies", default="all", help="all, or some of them by comma")
@click.option("--budgets", "--budget", default="1/4,1/8,1/16", help="shares of the pixel rate")
@click.option("--data", default=ROAD, help=f"{ROAD}, or a folder of videos or photographs")
@click.option("--labels", default="", help="one JSON file for the folder: RoadText-1K or TextOCR")
@click.option("--transcriptions", default="", help="RoadText-1K's second file, original release")
@click.option("--clips", default=10, help=f"of every row, up to {MOST_CLIPS}")
@click.option("--frames", default=60, help="of a clip")
@click.option("--seed", default=70_000, help="of the first street")
@graph_option(GRAPH)
@click.option("--set", "changes", multiple=True, help="node.setting=value of the graph")
@click.option("--policy", default="", help="an ONNX file in place of the graph's own policy")
@click.option(
    "--replace", "replaced", multiple=True, help="part known from the truth: " + ", ".join(PARTS)
)
@click.option("--without", multiple=True, help="input left out: " + ", ".join(INPUTS))
@click.option("--jobs", default=2, help="processes")
@click.option("--report", type=Path, help="JSON")
@click.option("--markdown", type=Path, help="the table as Markdown; - prints it")
@click.option("--plot", "picture", type=Path, help="share read over budget: PNG, PDF or SVG")
@click.option("--work", type=Path, help="folder for finished clips; else beside the report")
def command(**given: Any) -> None:
    """See the module."""
    evaluate(**given)


def evaluate(
    *, strategies: str, budgets: str, data: str, labels: str, transcriptions: str, clips: int,
    frames: int, seed: int, graph: str, changes: tuple[str, ...], policy: str,
    replaced: tuple[str, ...], without: tuple[str, ...], jobs: int, report: Path | None,
    markdown: Path | None, picture: Path | None, work: Path | None,
) -> None:  # fmt: skip
    """Measure what is asked for and write it; raises `FoveaError`."""
    for name, value, most in (("clips", clips, MOST_CLIPS), ("frames", frames, MOST_FRAMES)):
        if not 1 <= value <= most:
            raise SettingsError(f"{name}: expected 1 to {most}, got {value}")
    if seed < 0 or jobs < 1:
        raise SettingsError(f"seed, jobs: expected at least 0 and 1, got {seed} and {jobs}")
    if policy and not Path(policy).is_file():
        raise SettingsError(f"policy: expected an ONNX file, got {policy}")
    played = clips_of(
        data, count=clips, frames=frames, seed=seed, labels=labels, transcriptions=transcriptions
    )
    overlay = Overlay(changes=(*played[0].changes, *changes), clock="lockstep")
    size_px = size_of(load(Path(graph), overlay))
    asked = rows_of(
        strategies.split(","), parsed(budgets), size_px, policy=policy, replaced=replaced,
        without=without,
    )  # fmt: skip
    refuse_too_short(asked, frames)
    work = work_folder(work, report, "text.work")
    make_room(work, report=report, markdown=markdown, plot=picture)
    outcomes = measured(
        [
            Job(graph=graph, changes=changes, frames=frames, row=row, clip=clip)
            for clip in played
            for row in asked
        ],
        work,
        jobs,
    )
    found = {
        "bench": "reading",
        **facts(LIBRARIES),
        "graph": Path(graph).name,
        "changes": list(changes),
        "policy": Path(policy).name,
        "interval": METHOD,
        "data": data if data == ROAD else Path(data).name,
        "clips": len(played),
        "frames": frames,
        "seed": seed,
        "rows": [told(row, outcomes) for row in asked],
    }
    if report:
        write_whole(report, json.dumps(found, indent=1) + os.linesep)
    if picture:
        plot(found["rows"], picture)
    if markdown == STANDARD_OUTPUT:
        click.echo(markdown_of(found["rows"]))
        return
    if markdown:
        write_whole(markdown, markdown_of(found["rows"]))
    Console().print(table_of(found["rows"]))


def refuse_too_short(rows: Sequence[Row], frames: int) -> None:
    """Raise `SettingsError` for a long exposure that is not over when the clip is."""
    for row in rows:
        if row.strategy == EXPOSURE and frames * row.budget < 1:
            raise SettingsError(
                f"frames: {EXPOSURE} at {row.budget} needs at least {ceil(1 / row.budget)}, "
                f"got {frames}"
            )


Outcomes = dict[Row, list[Outcome]]


def measured(asked: Sequence[Job], folder: Path, jobs: int) -> Outcomes:
    """Return all outcomes: those of finished clips from the folder, others after playing them."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {
        job.row: folder / f"{key(job)}.json" for job in asked if job.clip.name == asked[0].clip.name
    }
    clips = {job.clip.name: job.clip for job in asked}
    digest_of = cache(file_digest)  # one file may have the labels of all clips
    contents = {name: clip.content(digest_of) for name, clip in clips.items()}
    found = {row: _read(path) for row, path in paths.items()}
    left = [job for job in asked if contents[job.clip.name] not in found[job.row]]
    with pool_of(jobs) as pool, bar("clips", len(asked), len(asked) - len(left)) as shown:
        for job, waiting in [(job, pool.submit(trial, job)) for job in left]:
            own = found[job.row]
            own[contents[job.clip.name]] = waiting.result()
            write_whole(paths[job.row], json.dumps({c: asdict(o) for c, o in own.items()}))
            shown.step(f"{job.row.name} {job.row.budget}")
    return {row: [found[row][content] for content in contents.values()] for row in found}


def key(job: Job) -> str:
    """Return the name of a row's file, by everything that determines its clips but the clip."""
    alike = replace(job, clip=replace(job.clip, changes=job.clip.alike))
    parts = of_plan(plan_of(alike)) | of_code(*CODE)
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def blocks(outcomes: Sequence[Outcome], what: str = "read") -> dict[str, Block]:
    """Return a block for each clip with legible texts."""
    return {
        o.clip: Block(total=float(getattr(o, what)), frames=o.legible, starts=1)
        for o in outcomes
        if o.legible
    }


def told(row: Row, outcomes: Outcomes) -> dict[str, Any]:
    """Return a row's figures; differences are paired by clip."""
    own = outcomes[row]
    share, nearly = mean(blocks(own)), mean(blocks(own, "nearly"))
    waits = [wait for o in own for wait in o.waits_s]
    found: dict[str, Any] = {
        "strategy": row.name,
        "budget": str(row.budget),
        "pixels": round(sum(o.pixels for o in own) / len(own), 5),
        "clips": len(own),
        "legible": sum(o.legible for o in own),
        "read": round(share.iou, 4),
        "ci95": finite(share.low, share.high),
        "nearly": round(nearly.iou, 4),
        "per_s": round(sum(o.read for o in own) / sum(o.duration_s for o in own), 3),
        "wait_s": round(median(waits), 3) if waits else None,
        "paper": PAPER.get((row.name, str(row.budget))),
    }
    full = outcomes.get(Row(strategy=FULL, budget=Fraction(1)))
    if full:
        found["of_full"] = round(share.iou / (mean(blocks(full)).iou or 1), 4)
    ours = next(
        (o for r, o in outcomes.items() if (r.name, r.budget) == (FOVEATED, row.budget)), own
    )
    if ours is not own:
        apart, low, high = difference(blocks(own), blocks(ours))
        found["to_foveated"], found["to_foveated_ci95"] = round(apart, 4), finite(low, high)
    return found


def finite(low: float, high: float) -> list[float] | None:
    """Return an interval; None over fewer clips than it needs."""
    return None if isnan(low) else [round(low, 4), round(high, 4)]


def within(interval: list[float] | None, form: str) -> str:
    """Return an interval as text, empty for none."""
    return f"{interval[0]:{form}} to {interval[1]:{form}}" if interval else ""


def cells(row: dict[str, Any]) -> list[str]:
    """Return a row as texts."""
    apart = f"{row['to_foveated']:+.3f}" if "to_foveated" in row else ""
    if arms := within(row.get("to_foveated_ci95"), "+.3f"):
        apart += f" ({arms})"
    return [
        row["strategy"],
        row["budget"],
        f"{row['read']:.3f}",
        within(row["ci95"], ".3f"),
        f"{row['nearly']:.3f}",
        f"{row['per_s']:.2f}",
        "" if row["wait_s"] is None else f"{row['wait_s']:.1f}",
        f"{row['of_full']:.2f}" if "of_full" in row else "",
        apart,
        "" if row["paper"] is None else f"{row['paper']:.3f}",
    ]


def table_of(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the table for the terminal."""
    strategy, budget, read, *others = HEAD
    table = lean_table(names=[strategy], figures=[budget, read, *others])
    for row in rows:
        table.add_row(*cells(row))
    return table


def markdown_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table as Markdown."""
    lines = [HEAD, ["---"] * len(HEAD), *(cells(row) for row in rows)]
    return "".join(f"| {' | '.join(each)} |\n" for each in lines)


def _read(path: Path) -> dict[str, Outcome]:
    """Return the outcomes in a file by their clip's content.

    None if it is missing or damaged, or made before contents were told: they are measured again.
    """
    try:
        return {content: Outcome(**each) for content, each in json.loads(path.read_text()).items()}
    except (FileNotFoundError, ValueError, TypeError, AttributeError):
        return {}


if __name__ == "__main__":
    command()
