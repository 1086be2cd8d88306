"""Verdict of a run: whether rate, loop latency and losses met their targets, and the results.

It is derived from the report's own figures. The results are the `headline` of each node's summary.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline.terminal import brief, pair
from pipeline.text import harmless

HELD_SHARE = 0.99  # a rate of at least this share of its target counts as held
BUDGET_FRAMES = {"p50": 1, "p99": 2}  # of the loop, in frames at the target rate
MOST_HEADLINES = 16
MOST_HZ = 1e9
MOST_CHARS = 200  # of a sentence
COLOUR = {True: "green", False: "red", None: ""}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line: the subject, whether it met its target (None: no target), and the sentence."""

    about: str
    held: bool | None = None
    sentence: str


def verdict(report: Mapping[str, Any]) -> list[Finding]:
    """Return the findings on a report of `compose`, in the order of display."""
    headlines = list(report.get("headlines", {}).items())
    told = [Finding(about=node, sentence=words) for node, words in headlines[:MOST_HEADLINES]]
    more = len(headlines) - len(told)
    if more > 0:
        told.append(Finding(about="others", sentence=f"{more} nodes more have a headline"))
    return [_rate(report), _loop(report), _losses(report), *_crashes(report), *told]


def as_data(findings: list[Finding]) -> list[dict[str, Any]]:
    """Return the findings for the JSON report."""
    return [asdict(finding) for finding in findings]


def print_verdict(console: Console, report: Mapping[str, Any]) -> None:
    """Print the findings: as a table in a terminal, one line each in a pipe."""
    left_out = (
        Finding(about=node, sentence=f"its summary is incomplete: {why}")
        for node, why in report.get("left_out", {}).items()
    )
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(overflow="fold", max_width=16)
    table.add_column(overflow="fold")
    for finding in (*verdict(report), *left_out):
        about = Text(harmless(finding.about, MOST_CHARS), style=COLOUR[finding.held])
        sentence = Text(harmless(finding.sentence, MOST_CHARS))
        if console.is_terminal:
            table.add_row(about, sentence)
        else:
            console.print(Text.assemble(about, ": ", sentence), soft_wrap=True)
    if console.is_terminal:
        console.print(table)


def _rate(report: Mapping[str, Any]) -> Finding:
    rate = report.get("rate") or {}
    frames = rate.get("frames", 0)
    if not frames:
        return Finding(about="rate", held=False, sentence="no frame was made")
    over = f"frames/s over {frames} {'frame' if frames == 1 else 'frames'}"
    asked, achieved = rate.get("asked_hz"), rate["achieved_hz"]
    if report["clock"] == "lockstep":
        said = f"{brief(achieved)} {over}, in lockstep: there is no rate to hold"
        return Finding(about="rate", sentence=said)
    if not asked:
        said = f"{brief(achieved)} {over}; its source names no rate to hold"
        return Finding(about="rate", sentence=said)
    figures = f"{brief(achieved)} of {brief(asked)} {over}"
    if achieved >= HELD_SHARE * asked:
        return Finding(about="rate", held=True, sentence=f"held: {figures}")
    short = f"fell short by {1 - achieved / asked:.0%}: {figures}"
    return Finding(about="rate", held=False, sentence=short)


def _loop(report: Mapping[str, Any]) -> Finding:
    loop = report.get("loop") or {}
    if report["clock"] == "lockstep":
        said = "no latency: in lockstep the source waits until its frame is answered"
        return Finding(about="loop", sentence=said)
    if not loop.get("closed"):
        return Finding(about="loop", sentence="none: no command goes back to a source")
    if not loop["commands"]:
        return Finding(about="loop", held=False, sentence="no command reached the source")
    latency_ms = loop["latency_ms"]
    figures = f"{pair(latency_ms)} ms p50/p99 from picture to command"
    asked = (report.get("rate") or {}).get("asked_hz")
    if not asked:
        said = f"{figures}; no budget, for its source names no rate"
        return Finding(about="loop", sentence=said)
    budget_ms = {name: 1000 * frames / asked for name, frames in BUDGET_FRAMES.items()}
    beyond = [
        f"{name} by {brief(latency_ms[name] - most_ms)} ms"
        for name, most_ms in budget_ms.items()
        if latency_ms[name] > most_ms
    ]
    figures += f", budget {pair(budget_ms)} ms (one and two frames)"
    if not beyond:
        return Finding(about="loop", held=True, sentence=f"held: {figures}")
    return Finding(
        about="loop", held=False, sentence=f"over its budget, {' and '.join(beyond)}: {figures}"
    )


def _losses(report: Mapping[str, Any]) -> Finding:
    edges = report["edges"]
    offered = sum(edge["offered"] for edge in edges)
    lost = {f"{e['from']} -> {e['to']}": (lost_on(e), e) for e in edges if lost_on(e)}
    again = ", ".join(f"{name} {count} times" for name, count in report["restarts"].items())
    restarts = f"; restarted: {again}" if again else ""
    if not lost:
        said = f"none of {offered} messages{restarts}"
        return Finding(about="losses", held=True, sentence=said)
    total = sum(count for count, _ in lost.values())
    place, (most, edge) = max(lost.items(), key=lambda item: item[1][0])
    reasons = ", ".join([*edge["dropped"], *(["with a process"] if edge["lost_in_crash"] else [])])
    where = f" on {len(lost)} edges, most on" if len(lost) > 1 else " on"
    count = f" ({most}, {reasons})" if len(lost) > 1 else f" ({reasons})"
    # of a viewer or recorder nothing was promised: no writer waits for it
    every = [(count, e) for count, e in lost.values() if e["keep"] == "every"]
    kept = [(count, alone(e, edges)) for count, e in every if not e.get("tap")]
    promised = sum(count - excused for count, excused in kept)
    excused = sum(excused for _, excused in kept)
    judged = (
        f"{promised} of them on edges that keep every message"
        if promised
        else f"{excused} of them of frames that their node's other inputs had missed before"
        if excused
        else "none on edges that a writer waits for"
        if every
        else "all on edges that keep only the newest"
    )
    said = f"{total} of {offered} messages{where} {place}{count}; {judged}{restarts}"
    return Finding(about="losses", held=not promised, sentence=said)


def _crashes(report: Mapping[str, Any]) -> list[Finding]:
    if said := crashed(report):
        return [Finding(about="processes", held=False, sentence=said)]
    return []


def crashed(report: Mapping[str, Any]) -> str:
    """Return a sentence on processes that crashed; empty when none did.

    >>> crashed({"crashes": {"eye": 1, "hand": 2}})
    '2 processes crashed: eye once, hand 2 times'
    """
    counts = report.get("crashes") or {}
    times = ", ".join(f"{n} {'once' if c == 1 else f'{c} times'}" for n, c in counts.items())
    some = "1 process" if len(counts) == 1 else f"{len(counts)} processes"
    return f"{some} crashed: {times}" if counts else ""


def lost_on(edge: Mapping[str, Any]) -> int:
    """Return the number of dropped or lost messages of an edge, without those in flight."""
    return int(sum(edge["dropped"].values())) + int(edge["lost_in_crash"])


def alone(edge: Mapping[str, Any], edges: Sequence[Mapping[str, Any]]) -> int:
    """Return how many messages of an edge were unmatched because the node's others never came.

    Those are counted where they were dropped. A detector that skips a frame leaves the picture of
    that frame without its detections; the edge that brought the picture has kept its promise.
    """
    node = edge["to"].partition(".")[0]
    fewest = min(e["offered"] for e in edges if e["to"].partition(".")[0] == node)
    return min(int(edge["dropped"].get("unmatched", 0)), int(edge["offered"]) - int(fewest))


def rate_of(frames: int, duration_s: float, told: object) -> dict[str, Any]:
    """Return the rate of a source: from its summary, if valid there, else frames per run time.

    >>> rate_of(50, 5.0, {"asked_hz": 30, "achieved_hz": 12.5})
    {'frames': 50, 'asked_hz': 30.0, 'achieved_hz': 12.5}
    >>> rate_of(50, 5.0, {"asked_hz": "fast"})
    {'frames': 50, 'asked_hz': None, 'achieved_hz': 10.0}
    """
    figures = told if isinstance(told, Mapping) else {}
    asked_hz, achieved_hz = (_hertz(figures.get(name)) for name in ("asked_hz", "achieved_hz"))
    if asked_hz and achieved_hz is not None:
        return {"frames": frames, "asked_hz": asked_hz, "achieved_hz": achieved_hz}
    by_clock = round(frames / duration_s, 3) if duration_s else 0.0
    return {"frames": frames, "asked_hz": None, "achieved_hz": by_clock}


def _hertz(value: Any) -> float | None:
    """Return a rate in Hz from an operator's summary; None for an invalid value."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if number and 0 <= value < MOST_HZ else None
