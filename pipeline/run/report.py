"""Report of a run: ledger, samples and summaries as one plain dictionary, and as tables."""

from collections.abc import Collection, Mapping, Sequence
from itertools import chain
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from pipeline.bus.ledger import Ledger
from pipeline.contract import HEADLINE, RATE
from pipeline.graph.plan import Node, Plan, sources
from pipeline.run.process_handle import Sample
from pipeline.run.verdict import as_data, print_verdict, rate_of, verdict
from pipeline.terminal import lean_table, losses, pair, rest
from pipeline.text import harmless

MOST_FIGURES = 64  # under one name, in a line of the report
# what no operator's summary can say of the run
OWN = ("failure", "left_out", "loop", "headlines", "profile", "verdict", HEADLINE, RATE)
TABLED = (
    "graph",
    "clock",
    "duration_s",
    "edges",
    "stages",
    "restarts",
    "crashes",
    "schedule_sha256",
)
Report = dict[str, Any]


def compose(
    plan: Plan,
    ledger: Ledger,
    summaries: Mapping[str, Mapping[str, Any]],
    samples: Mapping[str, Sequence[Sample]],
    *,
    duration_s: float,
    restarts: Mapping[str, int] | None = None,
    crashes: Mapping[str, int] | None = None,
    left_out: Mapping[str, str] | None = None,
    source_names: Collection[str] | None = None,
) -> Report:
    """Return the report of a run, with the figures of a source (frames, pixels, coverage) on top.

    Without the names of the sources, operators are imported to find them.
    """
    report: Report = {
        "graph": plan.name,
        "clock": plan.clock,
        "duration_s": round(duration_s, 3),
        "edges": [
            {"from": e.origin, "to": e.end, "keep": e.keep, **({"tap": True} if e.tap else {}),
             **ledger.edges[e.index].report(), "age_ms": ledger.edges[e.index].age.summary()}
            for e in plan.edges
        ],
        "stages": [
            _stage(node, ledger, samples.get(node.process, ()), duration_s) for node in plan.nodes
        ],
        "restarts": dict(restarts or {}),
        "crashes": dict(crashes or {}),
    }  # fmt: skip
    if left_out:
        report["left_out"] = dict(left_out)
    headlines = {}
    for node in plan.nodes:
        summary = summaries.get(node.name, {})
        for key, value in summary.items():
            if key not in OWN:
                report.setdefault(key, value)
        if isinstance(words := summary.get(HEADLINE), str) and words:
            headlines[node.name] = words
    report["headlines"] = headlines
    made = sources(plan) if source_names is None else map(plan.node, sorted(source_names))
    for source in made:
        told = summaries.get(source.name, {}).get(RATE) if plan.clock == "realtime" else None
        histograms = ledger.nodes[source.index].histograms
        report[RATE] = rate_of(histograms["handler"].total, duration_s, told)
        report["loop"] = {
            "latency_ms": histograms["loop"].summary(),
            "overhead_ms": histograms["overhead"].summary(),
            "scheduling_delay_ms": histograms["scheduling_delay"].summary(),
            "commands": histograms["loop"].total,
            "closed": any(e.command and e.target == source.name for e in plan.edges),
        }
    report["verdict"] = as_data(verdict(report))
    return report


def print_report(console: Console, report: Report, *, verbose: bool = False) -> None:
    """Print a report: its verdict and, if `verbose`, the tables behind it."""
    print_verdict(console, report)
    if verbose:
        console.print(Text(), tables(report), sep="\n")


def tables(report: Report) -> Group:
    """Return tables of edges and stages, and lines on the loop and the summaries."""
    told = (losses(e["from"], e["to"], e, broken=False) for e in report["edges"])
    return Group(_edge_table(report), *chain(*told), _stage_table(report), *_lines(report))


def _stage(
    node: Node, ledger: Ledger, samples: Sequence[Sample], duration_s: float
) -> dict[str, Any]:
    account = ledger.nodes[node.index]
    return {
        "node": node.name,
        **({"provider": account.provider} if account.provider else {}),
        "latency_ms": account.histograms["handler"].summary(),
        "hop_ms": account.histograms["hop"].summary(),
        "handled": account.handled,
        "rate_hz": round(account.handled / duration_s, 2) if duration_s else 0.0,
        "cpu_percent": _cpu_percent(samples),
        "rss_mb": round(samples[-1].rss_mb, 1) if samples else 0.0,
        "rss_first_mb": round(samples[0].rss_mb, 1) if samples else 0.0,
    }


def _cpu_percent(samples: Sequence[Sample]) -> float:
    """Return the mean over the last instance, as CPU time restarts at zero with a new process."""
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
            str(edge["delivered"]), rest(edge), _spread(edge["age_ms"]),
        )  # fmt: skip
    return table


def _stage_table(report: Report) -> Table:
    figures = ("handler ms", "hop ms", "rate Hz", "CPU %", "RSS MB")
    table = lean_table("stages, p50/p99", names=("node",), figures=figures)
    for stage in report["stages"]:
        table.add_row(
            Text(stage["node"]), _spread(stage["latency_ms"]), _spread(stage["hop_ms"]),
            f"{stage['rate_hz']:.1f}", f"{stage['cpu_percent']:.0f}", f"{stage['rss_mb']:.0f}",
        )  # fmt: skip
    return table


def _spread(figures: Mapping[str, float]) -> str:
    """Return median and 99th percentile as text, a dash without measurements."""
    return pair(figures) if figures["p99"] else "–"


def _lines(report: Report) -> list[Text]:
    lines = []
    loop = report.get("loop")
    if loop and loop["commands"] and report["clock"] == "realtime":
        lines.append(
            f"loop, picture ready -> command accepted: {pair(loop['latency_ms'])} ms p50/p99, "
            f"overhead {pair(loop['overhead_ms'])} ms, waiting for a core "
            f"{pair(loop['scheduling_delay_ms'])} ms, {loop['commands']} commands"
        )
    for key, value in report.items():
        if key not in (*OWN, *TABLED) and (values := _figures(value)):
            figures = ", ".join(f"{name} {_figure(each)}" for name, each in values.items())
            lines.append(f"{key}: {figures}")
    if report["restarts"]:
        counts = ", ".join(f"{name} {count}" for name, count in report["restarts"].items())
        lines.append(f"restarts: {counts}")
    return [Text(harmless(line)) for line in lines]


def _figures(value: Any) -> Mapping[str, Any]:
    """Return the figures of a summary that fit on one line; its content is untrusted."""
    return value if isinstance(value, Mapping) and len(value) <= MOST_FIGURES else {}


def _figure(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
