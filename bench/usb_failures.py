"""Every failure of the USB link, many times each: what the driver did, lost, and needed to recover.

`python -m bench.usb_failures --count 100`. Each injection is a virtual board of its own behind the
real driver, as a backend of pyusb (no kernel): it runs for some frames, fails at a random one, and
is read until five more have come. The board knows what it exposed: every exposure has to arrive
with the right pixels or be lost for a reason that the driver counted.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from logging import getLogger
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.progress import track

from bench.machine import LIBRARIES, facts
from bench.options import JSON, Bench
from bench.results.markdown import table_of
from bench.usb.gauge import spread
from bench.usb.injection import Injection, injected
from pipeline.text import harmless

FIRST, LAST = 5, 25  # exposures in which a failure happens
NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, kw_only=True)
class Case:
    """A kind of failure."""

    name: str  # as in the table of drivers/usb/README.md
    kinds: tuple[str, ...] = ()  # of drivers.virtual_board.faults, two exposures apart
    stream: str = "roi"
    seconds: tuple[float, float] = (0.0, 0.0)  # how long it lasts, drawn evenly
    pause: bool = False  # the reader pauses, the board does not fail
    at_a_time: int = 1  # those that mostly wait do so together


FOR_EVER_S = 3600.0
CASES = (
    Case(name="cable pulled", kinds=("unplug",), seconds=(0.02, 0.5)),
    Case(name="stall, context", kinds=("stall",), stream="context"),
    Case(name="stall, ROI", kinds=("stall",)),
    Case(name="stall, again within 1 s", kinds=("stall", "stall")),
    Case(name="truncated frame, context", kinds=("truncate",), stream="context"),
    Case(name="truncated frame, ROI", kinds=("truncate",)),
    Case(name="corrupt header, context", kinds=("corrupt_header",), stream="context"),
    Case(name="corrupt header, ROI", kinds=("corrupt_header",)),
    Case(name="corrupt pixels, context", kinds=("corrupt_payload",), stream="context"),
    Case(name="corrupt pixels, ROI", kinds=("corrupt_payload",)),
    Case(name="more than asked for, context", kinds=("overflow",), stream="context"),
    Case(name="more than asked for, ROI", kinds=("overflow",)),
    Case(name="frame missing, context", kinds=("skip",), stream="context"),
    Case(name="frame missing, ROI", kinds=("skip",)),
    Case(name="consumer too slow", seconds=(0.05, 0.3), pause=True),
    Case(name="silence", kinds=("silence",), seconds=(0.05, 2.0), at_a_time=4),
    Case(name="silence for ever", kinds=("silence",), seconds=(FOR_EVER_S,) * 2, at_a_time=4),
    Case(name="sensor broken", kinds=("broken",), at_a_time=4),
)  # fmt: skip


@click.command(cls=Bench, help=__doc__)
@click.option("--count", default=100, show_default=True, type=click.IntRange(1))
@click.option("--rate-hz", default=200.0, show_default=True, type=click.FloatRange(10, 1000))
@click.option("--only", multiple=True, help="Name of a failure; repeatable.")
@click.option("--seed", default=0, show_default=True)
@JSON
def main(count: int, rate_hz: float, only: tuple[str, ...], seed: int, path: Path | None) -> None:
    """Inject every failure and report."""
    names = [case.name for case in CASES]
    for name in only:
        if name not in names:
            raise click.BadParameter(
                f"expected {', '.join(names)}, got {name}", param_hint="--only"
            )
    wanted = [case for case in CASES if not only or case.name in only]
    with quiet():
        rows = [
            row(case, injections(case, count, rate_hz, seed)) for case in track(wanted, "failures")
        ]
    result = {
        "bench": "usb_failures", **facts((*LIBRARIES, "pyusb")), "seed": seed, "count": count,
        "rate_hz": rate_hz, "injected": count * len(rows),
        "unexplained": sum(r["unexplained"] for r in rows),
        "delivered_wrong": sum(r["wrong"] for r in rows), "failures": rows,
    }  # fmt: skip
    click.echo(table_of(rows))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


def injections(case: Case, count: int, rate_hz: float, seed: int) -> list[Injection]:
    """Inject a failure so many times."""

    def one(number: int) -> Injection:
        at, lasting_s = drawn(case, seed, number)
        faults = [
            {"kind": kind, "exposure": at + 2 * k, "stream": case.stream, "seconds": lasting_s}
            for k, kind in enumerate(case.kinds)
        ]
        if case.pause:
            return injected([], rate_hz=rate_hz, pause_s=lasting_s, pause_at=at)
        return injected(faults, rate_hz=rate_hz, lasting_s=lasting_s)

    with ThreadPoolExecutor(case.at_a_time) as pool:
        return list(pool.map(one, range(count)))


def drawn(case: Case, seed: int, number: int) -> tuple[int, float]:
    """Return the exposure at which the failure happens, and how long it lasts.

    The same for the same seed, whatever other failures are injected.
    """
    rng = np.random.default_rng([seed, CASES.index(case), number])
    return int(rng.integers(FIRST, LAST)), float(rng.uniform(*case.seconds))


def row(case: Case, found: Sequence[Injection]) -> dict[str, Any]:
    """Return the line of a failure: sums over all injections, and spreads."""
    lost: Counter[str] = Counter()
    events: Counter[str] = Counter()
    for one in found:
        lost.update(one.lost)
        events.update(one.events)
    recovered = [one.recovered_ms for one in found if one.recovered_ms >= 0]
    said = [one.said_ms for one in found if one.said_ms >= 0]
    times = spread(recovered) if recovered else dict.fromkeys(("p50", "p99", "most"))
    each = [sum(one.lost.values()) + one.unexplained for one in found]
    return {
        "failure": case.name, "times": len(found),
        "driver": listed(events), "sentence": usual_sentence(found),
        "said_p50_ms": round(float(np.median(said)), 1) if said else None,
        "exposed": sum(one.exposed for one in found),
        "delivered": sum(one.delivered for one in found),
        "lost": listed(lost) or "0", "unexplained": sum(one.unexplained for one in found),
        "wrong": sum(one.wrong for one in found),
        "lost_most": max(each, default=0),
        "never_exposed": sum(one.never_exposed for one in found),
        "recovered": len(recovered), "ended_with_error": sum(bool(one.error) for one in found),
        **{f"recovery_{name}_ms": value for name, value in times.items()},
    }  # fmt: skip


def listed(counts: Mapping[str, int]) -> str:
    """Return counts as text, the most frequent first.

    >>> listed({"a": 1, "b": 3})
    'b 3, a 1'
    """
    order = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {count}" for name, count in order)


def usual_sentence(found: Sequence[Injection]) -> str:
    """Return the most frequent first sentence, numbers aside, as it was said the first time."""
    firsts = [harmless(one.sentences[0]) for one in found if one.sentences]
    if not firsts:
        return ""
    usual = Counter(NUMBER.sub("#", text) for text in firsts).most_common(1)[0][0]
    return next(text for text in firsts if NUMBER.sub("#", text) == usual)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what the driver says off the terminal; the injections hear it."""
    logger = getLogger("drivers.usb")
    before, logger.propagate = logger.propagate, False
    try:
        yield
    finally:
        logger.propagate = before


if __name__ == "__main__":
    main()
