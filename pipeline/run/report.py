"""The account of a run: ledger, samples and summaries to one plain dictionary, and to a table."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from pipeline.bus.ledger import Ledger
from pipeline.graph.plan import Node, Plan, sources
from pipeline.run.process_handle import Sample
from pipeline.terminal import lean_table, losses, pair, rest
from pipeline.text import harmless

MOST_FIGURES = 64  # under one name, in a line of the report
OWN = ("failure", "left_out", "loop")  # what no operator's summary can say of the run
Report = dict[str, Any]


def compose(
    plan: Plan,
    ledger: Ledger,
    summaries: Mapping[str, Mapping[str, Any]],
    samples: Mapping[str, Sequence[Sample]],
    *,
    duration_s: float,
    restarts: Mapping[str, int] | None = None,
    left_out: Mapping[str, str] | None = None,
) -> Report:
    """The run's report. Figures that a source gives (frames, pixels, coverage) stand on top."""
    report: Report = {
        "graph": plan.name,
        "clock": plan.clock,
        "duration_s": round(duration_s, 3),
        "edges": [
            {"from": e.origin, "to": e.end, "keep": e.keep, **ledger.edges[e.index].report(),
             "age_ms": ledger.edges[e.index].age.summary()}
            for e in plan.edges
        ],
        "stages": [
            _stage(node, ledger, samples.get(node.process, ()), duration_s) for node in plan.nodes
        ],
        "restarts": dict(restarts or {}),
    }  # fmt: skip
    if left_out:
        report["left_out"] = dict(left_out)
    for node in plan.nodes:
        for key, value in summaries.get(node.name, {}).items():
            if key not in OWN:
                report.setdefault(key, value)
    for source in sources(plan):
        histograms = ledger.nodes[source.index].histograms
        report["loop"] = {
            "latency_ms": histograms["loop"].summary(),
            "overhead_ms": histograms["overhead"].summary(),
            "scheduling_delay_ms": histograms["scheduling_delay"].summary(),
            "commands": histograms["loop"].total,
        }
    return report


def tables(report: Report) -> Group:
    """The report for a terminal: every edge's account, every stage's latency, the loop."""
    told = (losses(e["from"], e["to"], e, broken=False) for e in report["edges"])
    return Group(_edge_table(report), *chain(*told), _stage_table(report), *_lines(report))


def _stage(
    node: Node, ledger: Ledger, samples: Sequence[Sample], duration_s: float
) -> dict[str, Any]:
    account = ledger.nodes[node.index]
    return {
        "node": node.name,
        "latency_ms": account.histograms["handler"].summary(),
        "hop_ms": account.histograms["hop"].summary(),
        "handled": account.handled,
        "rate_hz": round(account.handled / duration_s, 2) if duration_s else 0.0,
        "cpu_percent": _cpu_percent(samples),
        "rss_mb": round(samples[-1].rss_mb, 1) if samples else 0.0,
        "rss_first_mb": round(samples[0].rss_mb, 1) if samples else 0.0,
    }


def _cpu_percent(samples: Sequence[Sample]) -> float:
    """Mean over the last incarnation: processor time restarts at zero with a new process."""
    newest = list(samples)
    for i in range(len(samples) - 1, 0, -1):
        if samples[i].cpu_s < samples[i - 1].cpu_s or samples[i].pid != samples[i - 1].pid:
            newest = list(samples[i:])
            break
    if len(newest) < 2:
        return 0.0
    first, last = newest[0], newest[-1]
    return round(100 * (last.cpu_s - first.cpu_s) / max(1e-9, last.at_s - first.at_s), 1)


def _edge_table(report: Report) -> Table:
    table = lean_table(
        "edges: offered = delivered + rest (in flight, dropped or lost), p50/p99",
        names=("from", "to"), words=("keep",), figures=("offered", "delivered", "rest", "age ms"),
    )  # fmt: skip
    for edge in report["edges"]:
        table.add_row(
            Text(edge["from"]), Text(edge["to"]), edge["keep"], str(edge["offered"]),
            str(edge["delivered"]), rest(edge), pair(edge["age_ms"]),
        )  # fmt: skip
    return table


def _stage_table(report: Report) -> Table:
    figures = ("handler ms", "hop ms", "rate Hz", "CPU %", "RSS MB")
    table = lean_table("stages, p50/p99", names=("node",), figures=figures)
    for stage in report["stages"]:
        table.add_row(
            Text(stage["node"]), pair(stage["latency_ms"]), pair(stage["hop_ms"]),
            f"{stage['rate_hz']:.1f}", f"{stage['cpu_percent']:.0f}", f"{stage['rss_mb']:.0f}",
        )  # fmt: skip
    return table


def _lines(report: Report) -> list[Text]:
    lines = []
    left_out: Mapping[str, str] = report.get("left_out", {})
    if loop := report.get("loop"):
        lines.append(
            f"loop, picture ready -> command accepted: {pair(loop['latency_ms'])} ms p50/p99, "
            f"overhead {pair(loop['overhead_ms'])} ms, waiting for a core "
            f"{pair(loop['scheduling_delay_ms'])} ms, {loop['commands']} commands"
        )
    for key in ("frames", "pixels", "commands"):
        if values := _figures(report.get(key)):
            counts = ", ".join(f"{name} {value}" for name, value in values.items())
            lines.append(f"{key}: {counts}")
    if coverage := _figures(report.get("roi_coverage")):
        shares = ", ".join(f"{n} {_share(v)}" for n, v in coverage.items())
        lines.append(f"ROI coverage of the true boxes: {shares}")
    if (overlap := _figures(report.get("iou"))) and {"mean", "frames"} <= overlap.keys():
        mean, frames = _share(overlap["mean"]), overlap["frames"]
        told = overlap.get("answered")
        answered = f", a box in {told:.1%} of them" if isinstance(told, float) else ""
        lines.append(f"IoU with the truth: {mean} over {frames} frames{answered}")
    if report["restarts"]:
        counts = ", ".join(f"{name} {count}" for name, count in report["restarts"].items())
        lines.append(f"restarts: {counts}")
    lines += [f"{node}: its summary is left out: {why}" for node, why in left_out.items()]
    return [Text(harmless(line)) for line in lines]


def _figures(value: Any) -> Mapping[str, Any]:
    """Figures as the parts that ship give them; an operator may say anything under that name."""
    return value if isinstance(value, Mapping) and len(value) <= MOST_FIGURES else {}


def _share(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
