"""`fovea eval shirts`: who is named by a shirt number, and whether the name stays with that player.

A clip is the graph in lockstep over the whole pitch of a seed. A player is legible if the number is
so in at least one frame at full resolution, read once the reader has said the right number, and
named once the track on it has the right name, which takes votes of several readings. In the frames
after that in which the player is in view, its track has the right name, another, or none. All rows
have the same clips. Seeds of 0 to 9,999 are for training, 50,000 to 59,999 for
development, 70,000 to 79,999 for tables.
"""

import json
import os
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from statistics import median
from typing import Any

import click

from bench.machine import facts
from bench.options import Bench, graph_option
from bench.outputs import make_room, work_folder
from bench.reading.evaluate import finite, within
from bench.shirts.tally import Counts
from bench.shirts.trial import STRATEGIES, Job, Outcome, plan_of, rate_of, trial
from bench.tracking.budgets import parsed
from bench.tracking.intervals import METHOD, Block, Mean, mean
from operators.training.identity import of_code, of_plan
from operators.training.progress import bar
from operators.training.workers import pool_of
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

GRAPH = Path(__file__).parents[2] / "graphs" / "shirts.yaml"
LIBRARIES = ("numpy", "onnxruntime", "opencv-python-headless", "rapidocr")
CODE = ("drivers.scenes", "drivers.simulated", "bench.shirts.tally", "bench.shirts.trial")
MOST = 100_000
HEAD = (
    *("strategy", "budget", "players named", "95 %", "read at least once", "of all", "wait s"),
    *("right name kept", "95 %", "wrong name", "names that are right", "readings alone"),
)


@click.command(
    cls=Bench,
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--strategies", default="all", help=f"all, or some by comma: {', '.join(STRATEGIES)}")
@click.option("--budgets", default="1/8", show_default=True, help="shares of the pixel rate")
@click.option("--clips", default=8, show_default=True, help="of every row")
@click.option("--frames", default=90, show_default=True, help="of a clip")
@click.option("--seed", default=70_000, show_default=True, help="of the first match")
@graph_option(GRAPH)
@click.option("--set", "changes", multiple=True, help="node.setting=value of the graph")
@click.option("--jobs", default=2, show_default=True, help="processes")
@click.option("--report", type=Path, help="JSON")
@click.option("--work", type=Path, help="folder for finished clips; else beside the report")
def command(
    strategies: str, budgets: str, clips: int, frames: int, seed: int, graph: str,
    changes: tuple[str, ...], jobs: int, report: Path | None, work: Path | None,
) -> None:  # fmt: skip
    """See the module."""
    for name, value in (("clips", clips), ("frames", frames), ("jobs", jobs)):
        if not 1 <= value <= MOST:
            raise SettingsError(f"{name}: expected 1 to {MOST}, got {value}")
    if seed < 0:
        raise SettingsError(f"seed: expected at least 0, got {seed}")
    wanted = STRATEGIES if strategies == "all" else tuple(strategies.split(","))
    rows = [
        (strategy, budget)
        for strategy in dict.fromkeys(wanted)
        for budget in ([Fraction(1)] if strategy == "full" else parsed(budgets))
    ]
    work = work_folder(work, report, "shirts.work")
    make_room(work, report=report)
    jobs_of = {
        row: [
            Job(
                graph=graph, changes=changes, frames=frames, seed=seed + clip, strategy=row[0],
                budget=row[1],
            )
            for clip in range(clips)
        ]
        for row in rows
    }  # fmt: skip
    outcomes = measured([job for own in jobs_of.values() for job in own], work, jobs)
    told = [
        summed(row, [outcomes[job] for job in own], rate_of(plan_of(own[0])))
        for row, own in jobs_of.items()
    ]
    found = {
        "bench": "shirts",
        **facts(LIBRARIES),
        "graph": Path(graph).name,
        "changes": list(changes),
        "interval": METHOD,
        "clips": clips,
        "frames": frames,
        "seed": seed,
        "rows": told,
    }
    if report:
        write_whole(report, json.dumps(found, indent=1) + os.linesep)
    click.echo(" | ".join(HEAD))
    for row in told:
        click.echo(" | ".join(cells(row)))


def measured(asked: Sequence[Job], folder: Path, jobs: int) -> dict[Job, Outcome]:
    """Return all outcomes: those of finished clips from the folder, others after playing them."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {job: folder / f"{key(job)}.json" for job in asked}
    found = {job: done for job, path in files.items() if (done := read(path)) is not None}
    left = [job for job in asked if job not in found]
    with pool_of(jobs) as pool, bar("clips", len(asked), len(found)) as shown:
        waiting = {pool.submit(trial, job): job for job in left}
        for each in as_completed(waiting):
            job = waiting[each]
            found[job] = each.result()
            write_whole(files[job], json.dumps(asdict(found[job])))
            shown.step(f"{job.strategy} {job.budget}")
    return found


def key(job: Job) -> str:
    """Return the name of a clip's file, by everything that determines it."""
    parts = {**of_plan(plan_of(job)), **of_code(*CODE), "seed": str(job.seed)}
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def read(path: Path) -> Outcome | None:
    """Return a finished clip; None if the file is missing or damaged: it is played again."""
    try:
        told = json.loads(path.read_text())
        both = {
            name: Counts(**{**told[name], "waits": tuple(told[name]["waits"])})
            for name in ("counts", "alone")
        }
        return Outcome(**{**told, **both})
    except (FileNotFoundError, ValueError, TypeError, KeyError):
        return None


def share(outcomes: Sequence[Counts], part: str, whole: str) -> Mean:
    """Return a share over clips, with its interval; clips without any are left out."""
    blocks = {
        str(clip): Block(total=float(getattr(o, part)), frames=getattr(o, whole), starts=1)
        for clip, o in enumerate(outcomes)
        if getattr(o, whole)
    }
    return mean(blocks)


def summed(
    row: tuple[str, Fraction], outcomes: Sequence[Outcome], rate_hz: float
) -> dict[str, Any]:
    """Return a row's figures, of clips with `rate_hz` frames a second; None where nothing counts.

    `named` is of names that tracks have, `read` of readings alone.
    """
    counts, alone = [o.counts for o in outcomes], [o.alone for o in outcomes]
    known = share(counts, "read", "legible")
    kept, wrong = share(counts, "kept", "after"), share(counts, "wrong", "after")
    right = share(counts, "named_rightly", "named")
    waits = [wait for o in counts for wait in o.waits]
    return {
        "strategy": row[0],
        "budget": str(row[1]),
        "pixels": round(sum(o.pixels for o in outcomes) / len(outcomes), 5),
        "legible": sum(o.legible for o in counts),
        "named": number(known.iou),
        "named_ci95": finite(known.low, known.high),
        "wait_s": round(median(waits) / rate_hz, 2) if waits else None,
        "after": sum(o.after for o in counts),
        "kept": number(kept.iou),
        "kept_ci95": finite(kept.low, kept.high),
        "wrong": number(wrong.iou),
        "named_rightly": number(right.iou),
        "alone": {
            "read": number(share(alone, "read", "legible").iou),
            "kept": number(share(alone, "kept", "after").iou),
            "named_rightly": number(share(alone, "named_rightly", "named").iou),
        },
    }


def number(value: float) -> float | None:
    """Return a share for a report; None where nothing counts."""
    return None if value != value else round(value, 4)


def cells(row: dict[str, Any]) -> list[str]:
    """Return a row as texts."""

    def told(value: float | None, form: str = ".3f") -> str:
        return "" if value is None else f"{value:{form}}"

    return [
        row["strategy"], row["budget"], told(row["named"]), within(row["named_ci95"], ".2f"),
        told(row["alone"]["read"]), str(row["legible"]), told(row["wait_s"], ".1f"),
        told(row["kept"]), within(row["kept_ci95"], ".2f"), told(row["wrong"]),
        told(row["named_rightly"]), told(row["alone"]["kept"]),
    ]  # fmt: skip
