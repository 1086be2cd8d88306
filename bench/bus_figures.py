"""Figures of `bench.bus`: contestants' clocks -> quantiles per contestant and size, and a table."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from bench.peers.ruler import COLUMNS

Result = dict[str, Any]  # what a contestant prints: see bench.peers.ruler.collect
NAN = float("nan")
COLUMNS_SHOWN = (
    "p50", "p99", "min", "x fovea", "write", "read", "cpu out", "cpu in", "lost",
)  # fmt: skip


def summarise(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Return figures per contestant and size over all rounds, in milliseconds.

    `beyond_ms` is the time for borrowing memory and handing over, without writing and reading;
    `p50_rounds` holds the least and the greatest median of a single round.
    """
    grouped: dict[tuple[str, int], list[Result]] = {}
    for result in results:
        grouped.setdefault((result["contestant"], result["nbytes"]), []).append(result)
    return [figures_of(group) for _, group in sorted(grouped.items(), key=lambda g: g[0][::-1])]


def figures_of(group: list[Result]) -> dict[str, Any]:
    """Return one row: a contestant at one size."""
    rounds = [beyond_ms(r) for r in group if r["samples"]]
    every = np.concatenate([*rounds, np.zeros(0)])
    sent = sum(r["sent"] for r in group)
    medians = [float(np.median(r)) for r in rounds]
    samples = np.concatenate([rows(r) for r in group])
    return {
        "contestant": group[0]["contestant"],
        "version": group[0]["version"],
        "nbytes": group[0]["nbytes"],
        "sent": sent,
        "lost": sent - len(every),
        "torn": sum(r["torn"] for r in group),
        "beyond_ms": quantiles(every),
        "p50_rounds": [round(v, 4) for v in (min(medians, default=0), max(medians, default=0))],
        "write_ms": quantiles((samples[:, 3] - samples[:, 2]) / 1e6),
        "read_ms": quantiles((samples[:, 5] - samples[:, 4]) / 1e6),
        "bare_write_ms": quantiles(np.array([v for r in group for v in r["bare_write_ns"]]) / 1e6),
        "bare_read_ms": quantiles(np.array([v for r in group for v in r["bare_read_ns"]]) / 1e6),
        "sender_cpu_ms": round(sum(r["sender_cpu_ns"] for r in group) / sent / 1e6, 4),
        "receiver_cpu_ms": round(sum(r["receiver_cpu_ns"] for r in group) / sent / 1e6, 4),
    }


def rows(result: Result) -> NDArray[np.int64]:
    """Return the clocks (n, 6) in nanoseconds, columns as in `ruler.COLUMNS`."""
    return np.array(result["samples"], np.int64).reshape(-1, len(COLUMNS))


def beyond_ms(result: Result) -> NDArray[np.float64]:
    """Return the time (n,) that each message took beyond writing and reading it.

    >>> clocks = [0, 1_000_000, 1_250_000, 4_000_000, 4_500_000, 9_000_000]
    >>> beyond_ms({"samples": [clocks]}).tolist()
    [0.75]
    """
    _, asked, writing, written, received, _ = rows(result).T
    beyond: NDArray[np.float64] = ((writing - asked) + (received - written)) / 1e6
    return beyond


def quantiles(values_ms: NDArray[np.float64]) -> dict[str, float]:
    """Return least, median and 99th percentile; empty without values."""
    if not len(values_ms):
        return {}
    p50, p99 = np.percentile(values_ms, [50, 99])
    least = float(values_ms.min())
    return {"min": round(least, 4), "p50": round(float(p50), 4), "p99": round(float(p99), 4)}


def table(figures: list[dict[str, Any]], nbytes: int, labels: Mapping[str, str]) -> Table:
    """Return a table of one size: ms beyond writing and reading, with ratios to fovea's median."""
    shown = Table(
        Column("contestant", no_wrap=True),
        *(Column(name, justify="right", min_width=5) for name in COLUMNS_SHOWN),
        title=f"{nbytes} bytes: ms beyond writing and reading; medians of both; processor time",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    here = [row for row in figures if row["nbytes"] == nbytes]
    ours_ms = median_of_ours(here)
    for row in sorted(here, key=lambda r: float(r["beyond_ms"].get("p50", np.inf))):
        shown.add_row(*cells(row, labels, ours_ms))
    return shown


def median_of_ours(here: list[dict[str, Any]]) -> float:
    """Return fovea's median among the rows of one size, NaN without it."""
    ours = [row["beyond_ms"] for row in here if row["contestant"] == "fovea_bus"]
    return float(ours[0]["p50"]) if ours and ours[0] else NAN


def cells(row: Mapping[str, Any], labels: Mapping[str, str], ours_ms: float) -> list[str]:
    """Return the cells of one line of the table."""
    beyond = row["beyond_ms"] or dict.fromkeys(("min", "p50", "p99"), NAN)
    spans = [row[name].get("p50", NAN) for name in ("write_ms", "read_ms")]
    return [
        labels.get(row["contestant"], row["contestant"]),
        *(f"{beyond[name]:.2f}" for name in ("p50", "p99", "min")),
        f"{beyond['p50'] / ours_ms:.2f}",
        *(f"{span:.2f}" for span in spans),
        f"{row['sender_cpu_ms']:.2f}",
        f"{row['receiver_cpu_ms']:.2f}",
        str(row["lost"]),
    ]
