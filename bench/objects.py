"""Cost of objects in a running graph: `python -m bench.objects [GRAPH] [--together] [--json …]`.

Runs a tracking graph of processes in real time with 1 to 25 objects (`bench/crowd.py`), several
rounds in shuffled order. Prints for each number of objects: how many of them the ROI encoder
described; the handler times of encoder and policy, the time in which the policy notes the encoder's
features, and the sum of the three; the processor time of both processes per frame, which tells a
busy machine from a slow stage; picture ready -> command accepted, overhead and drops.
"""

import json
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.crowd import CrowdSettings, with_crowd
from bench.loop import spread
from bench.machine import facts
from bench.options import JSON, Bench, file_name, on_graph, told_changes
from bench.run_time import COUNTS
from pipeline.bus.histogram import BUCKETS, Histogram
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.run.report import Report, compose
from pipeline.run.supervisor import Supervisor

COLUMNS = {
    "encoded": "encoded", "encoder_ms": "encoder ms", "policy_ms": "policy ms",
    "noting_ms": "noting ms", "together_ms": "together ms", "processor_ms": "processor ms",
}  # fmt: skip


@click.command(cls=Bench)
@on_graph
@click.option("--objects", "counts", multiple=True, type=click.IntRange(1, 25),
              help="Number of objects; repeatable. [default: 1, 5, 10, 15, 20, 25]")  # fmt: skip
@click.option("--together", is_flag=True, help="All inside the ROI, else at the real ones.")
@click.option("--frames", default=250, show_default=True, type=click.IntRange(10))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=0, show_default=True, help="Of the order.")
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], counts: tuple[int, ...],
    together: bool, frames: int, rounds: int, seed: int, path: Path | None,
) -> None:  # fmt: skip
    """Measure encoder, policy and loop by the number of objects."""
    overlay = Overlay(source=source, changes=changes, clock="realtime")
    plan = load(graph, overlay)
    counts = counts or COUNTS
    plans = {n: with_crowd(plan, CrowdSettings(objects=n, together=together)) for n in counts}
    rng = np.random.default_rng(seed)
    order = [int(n) for _ in range(rounds) for n in rng.permutation(counts)]
    runs: list[dict[str, Any]] = []
    with Progress() as progress:
        task = progress.add_task("starting", total=len(order) * frames)
        for turn, count in enumerate(order):
            progress.update(task, description=f"{count} objects, run {turn + 1} of {len(order)}")
            runs.append({"objects": count, **run(plans[count], frames)})
            progress.update(task, completed=(turn + 1) * frames)
    result = {"bench": "objects", **facts(), "graph": file_name(graph),
              "source": file_name(source) if source else "", "changes": told_changes(changes),
              "together": together, "frames": frames, "rounds": rounds, "seed": seed,
              "summary": {str(n): summarise(_of(runs, n)) for n in counts},
              "runs": runs}  # fmt: skip
    Console().print(table(result["summary"], together=together))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))


def run(plan: Plan, frames: int) -> Report:
    """Run a plan; return its report with the times in which the policy noted features."""
    with Supervisor(plan, frames=frames) as supervisor:
        supervisor.start()
        while not supervisor.finished:
            supervisor.tick()
            if supervisor.failure:
                raise click.ClickException(supervisor.failure)
        elapsed_s = time.monotonic() - supervisor.started_s
        supervisor.finish()
        supervisor.stop()
        report = compose(
            plan, supervisor.ledger, supervisor.reports.summaries,
            {name: supervisor.samples(name) for name in plan.processes()},
            duration_s=elapsed_s, restarts=supervisor.restarts,
        )  # fmt: skip
        called = supervisor.ledger.nodes[plan.node("policy").index].histograms["handler"]
        plans = report["witness"]["policy"]["handler_ns"]
        return {**report, "noting_ms": called.since(counted(plans).counts).summary()}


def counted(durations_ns: Iterable[int]) -> Histogram:
    """Return a histogram of durations in the ledger's buckets."""
    histogram = Histogram(np.zeros(BUCKETS, np.uint32))
    for duration_ns in durations_ns:
        histogram.add(duration_ns)
    return histogram


def summarise(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise runs with the same number of objects: handlers over all frames, the loop by rounds.

    Only frames with all objects count, because a track begins with its second sighting.
    """
    rows = [row for one in runs for row in frames_of(one["witness"], one["objects"])]
    encoded, encoder_ns, policy_ns = np.array(rows, np.int64).reshape(-1, 3).T
    noting = {share: median(one["noting_ms"][share] for one in runs) for share in ("p50", "p99")}
    both = _percentiles(encoder_ns + policy_ns)
    loop = {
        f"{name}_{share}": spread([one["loop"][name][share] for one in runs])
        for name in ("latency_ms", "overhead_ms")
        for share in ("p50", "p99")
    }
    return {
        "frames": len(rows),
        "encoded": float(np.median(encoded)) if len(rows) else 0.0,
        "encoder_ms": _percentiles(encoder_ns),
        "policy_ms": _percentiles(policy_ns),
        "noting_ms": noting,
        # features are noted in another call: the two percentiles are added
        "together_ms": {share: round(both[share] + noting[share], 3) for share in both},
        "processor_ms": round(median(map(processor_ms, runs)), 3),
        "loop": loop,
        "drops": sum(sum(edge["dropped"].values()) for one in runs for edge in one["edges"]),
    }


def processor_ms(one: Mapping[str, Any]) -> float:
    """Return the processor time of encoder and policy per frame, bus and bookkeeping included."""
    each_s: float = one["duration_s"] / max(1, max(edge["offered"] for edge in one["edges"]))
    shares = (s["cpu_percent"] for s in one["stages"] if s["node"] in ("roi_features", "policy"))
    return sum(float(share) for share in shares) / 100 * each_s * 1000


def frames_of(witness: Mapping[str, Any], count: int) -> list[tuple[int, int, int]]:
    """Return encoded objects and the nanoseconds of both stages for frames with `count` objects."""
    encoder, policy = ({f: (o, ns) for f, o, ns in zip(*w.values(), strict=True)}
                       for w in (witness["encoder"], witness["policy"]))  # fmt: skip
    return [
        (*encoder[frame], ns)
        for frame, (objects, ns) in policy.items()
        if objects == count and frame in encoder
    ]


def table(summary: Mapping[str, Mapping[str, Any]], *, together: bool) -> Table:
    """Return the figures as a table: p50 / p99."""
    where = "all inside the ROI" if together else "where the real ones are"
    shown = Table(title=f"encoder and policy in the loop, objects {where}; p50 / p99")
    for column in ("objects", *COLUMNS.values(), "loop ms", "overhead ms", "drops"):
        shown.add_column(column, justify="right")
    for count, found in summary.items():
        cells = [found[name] for name in COLUMNS]
        loop = [{share: found["loop"][f"{name}_{share}"]["median"] for share in ("p50", "p99")}
                for name in ("latency_ms", "overhead_ms")]  # fmt: skip
        shown.add_row(count, *(_cell(value) for value in (*cells, *loop)), str(found["drops"]))
    return shown


def _cell(value: float | Mapping[str, float]) -> str:
    if isinstance(value, Mapping):
        return f"{value['p50']:.2f} / {value['p99']:.2f}"
    return f"{value:g}"


def _percentiles(values_ns: Any) -> dict[str, float]:
    if not len(values_ns):
        return {"p50": 0.0, "p99": 0.0}
    return {
        f"p{share}": round(float(np.percentile(values_ns, share)) / 1e6, 3) for share in (50, 99)
    }


def _of(runs: Sequence[dict[str, Any]], count: int) -> list[dict[str, Any]]:
    return [one for one in runs if one["objects"] == count]


if __name__ == "__main__":
    main()
