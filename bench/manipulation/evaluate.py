"""`fovea eval manipulation`: success of a frozen consumer by strategy and pixel budget.

A trial is the graph in lockstep from the start of a seed, until the peg is inserted (complete) or
400 steps are over; partial is peg and socket touching in the air, or more. All rows have the same
trials. Seeds of 0 to 9,999 are for training, 50,000 to 59,999 for development, 70,000 to 79,999 for
tables.
"""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from bench.machine import facts
from bench.manipulation.intervals import METHOD, paired, wilson
from bench.manipulation.rows import Row, parsed, rows_of
from bench.manipulation.trial import Job, Outcome, needed, plan_of, trial
from bench.options import graph_option
from bench.outputs import STANDARD_OUTPUT, make_room, work_folder
from drivers.scenes.insertion import COMPLETE, PARTIAL
from operators.training.identity import of_code, of_plan
from operators.training.progress import bar
from operators.training.workers import pool_of
from pipeline.errors import FoveaError, SettingsError
from pipeline.whole_file import write_whole

GRAPH = Path(__file__).parents[2] / "graphs" / "manipulation.yaml"
LIBRARIES = ("numpy", "onnxruntime", "opencv-python-headless", "mujoco", "gym-aloha")
CODE = ("drivers.scenes.insertion", "drivers.simulated", "bench.manipulation.trial")
MOST_TRIALS = 10_000


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--strategies", default="all", help="all, or some of them by comma")
@click.option("--budgets", "--budget", default="1/8,1/16,1/32", help="shares of the pixel rate")
@click.option("--trials", default=100, help="of every row")
@click.option("--seed", default=70_000, help="of the first trial")
@click.option("--consumer", default="", help="an ONNX file in place of the graph's own network")
@graph_option(GRAPH)
@click.option("--set", "changes", multiple=True, help="node.setting=value of the graph")
@click.option("--jobs", default=2, help="processes")
@click.option("--report", type=Path, help="JSON")
@click.option("--markdown", type=Path, help="the table as Markdown; - prints it")
@click.option("--work", type=Path, help="folder for finished trials; else beside the report")
def command(**given: Any) -> None:
    """See the module."""
    try:
        evaluate(**given)
    except FoveaError as error:
        click.echo(f"fovea eval manipulation: {error}", err=True)
        sys.exit(2)


def evaluate(
    *, strategies: str, budgets: str, trials: int, seed: int, consumer: str, graph: str,
    changes: tuple[str, ...], jobs: int, report: Path | None, markdown: Path | None,
    work: Path | None,
) -> None:  # fmt: skip
    """Measure what is asked for and write it; raises `FoveaError`."""
    if not 1 <= trials <= MOST_TRIALS or seed < 0 or jobs < 1:
        raise SettingsError(
            f"trials, seed, jobs: expected 1 to {MOST_TRIALS}, at least 0 and at least 1, got "
            f"{trials}, {seed} and {jobs}"
        )
    if consumer:
        changes = (*changes, f"manipulation.weights={consumer}")
    own = Job(graph=graph, changes=changes)
    asked = rows_of(strategies.split(","), parsed(budgets), plan_of(own))
    work = work_folder(work, report, "manipulation.work")
    make_room(work, report=report, markdown=markdown)
    outcomes = measured(own, asked, range(seed, seed + trials), work, jobs)
    found = {
        "bench": "manipulation",
        **facts(LIBRARIES),
        "graph": Path(graph).name,
        "changes": list(changes),
        "interval": METHOD,
        "trials": trials,
        "seed": seed,
        "rows": [told(row, outcomes) for row in asked],
    }
    if report:
        write_whole(report, json.dumps(found, indent=1) + os.linesep)
    if markdown == STANDARD_OUTPUT:
        click.echo(markdown_of(found["rows"]))
        return
    if markdown:
        write_whole(markdown, markdown_of(found["rows"]))
    Console().print(table_of(found["rows"]))


Outcomes = dict[Row, list[Outcome]]


def measured(
    own: Job, rows: Sequence[Row], seeds: Sequence[int], folder: Path, jobs: int
) -> Outcomes:
    """Return all outcomes: those of finished trials from the folder, others after running them."""
    folder.mkdir(parents=True, exist_ok=True)
    of_row = {row: Job(graph=own.graph, changes=(*own.changes, *row.changes)) for row in rows}
    paths = {row: folder / f"{key(job)}.json" for row, job in of_row.items()}
    found = {row: {o.seed: o for o in _read(path)} for row, path in paths.items()}
    left = [(row, seed) for seed in seeds for row in rows if seed not in found[row]]
    done = len(rows) * len(seeds) - len(left)
    with pool_of(jobs) as pool, bar("trials", len(rows) * len(seeds), done) as shown:
        waiting = [(row, pool.submit(trial, of_row[row], seed)) for row, seed in left]
        for row, job in waiting:
            outcome = job.result()
            found[row][outcome.seed] = outcome
            write_whole(paths[row], json.dumps([asdict(o) for o in found[row].values()]))
            shown.step(f"{row.strategy} {row.budget}")
    return {row: [found[row][seed] for seed in seeds] for row in rows}


def key(job: Job) -> str:
    """Return the name of a row's file, by everything that determines its trials but the seed."""
    parts = of_plan(needed(plan_of(job, "robot.seed=0"))) | of_code(*CODE)
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def told(row: Row, outcomes: Outcomes) -> dict[str, Any]:
    """Return a row's figures, with its differences to full resolution where that was measured."""
    own = outcomes[row]
    found: dict[str, Any] = {
        "strategy": row.strategy,
        "budget": str(row.budget),
        "pixels": round(sum(o.pixels for o in own) / len(own), 5),
        "trials": len(own),
        "rewards": [o.reward for o in own],
    }
    full = outcomes.get(Row(strategy="full", budget=Fraction(1)))
    for name, least in (("complete", COMPLETE), ("partial", PARTIAL)):
        reached = [o.reward >= least for o in own]
        low, high = wilson(sum(reached), len(reached))
        found[name] = {
            "share": round(sum(reached) / len(reached), 4),
            "interval": [round(low, 4), round(high, 4)],
        }
        if full and full is not own:
            against = paired(reached, [o.reward >= least for o in full])
            found[name]["difference_to_full"] = [round(value, 4) for value in against]
    return found


def table_of(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the table for the terminal."""
    table = Table("strategy", "budget", "complete", "95 %", "partial", "95 %", "difference to full")
    for row in rows:
        table.add_row(*_cells(row))
    return table


def markdown_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table as Markdown."""
    head = ["strategy", "budget", "complete", "95 %", "partial", "95 %", "difference to full"]
    lines = [head, ["---"] * len(head), *(_cells(row) for row in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _cells(row: dict[str, Any]) -> list[str]:
    cells = [row["strategy"], row["budget"]]
    for name in ("complete", "partial"):
        low, high = row[name]["interval"]
        cells += [f"{row[name]['share']:.2f}", f"{low:.2f} to {high:.2f}"]
    apart = row["complete"].get("difference_to_full")
    return [*cells, "{:+.2f} ({:+.2f} to {:+.2f})".format(*apart) if apart else ""]


def _read(path: Path) -> list[Outcome]:
    """Return the outcomes in a file; none if it is missing or damaged: they are measured again."""
    try:
        return [Outcome(**each) for each in json.loads(path.read_text())]
    except (FileNotFoundError, ValueError, TypeError):
        return []


if __name__ == "__main__":
    command()
