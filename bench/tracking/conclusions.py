"""Conclusions of an evaluation as sentences: paired differences of the policy to the others.

One clip has no interval, because its frames depend on one another, and few clips have none, because
it would not hold its level (`intervals`). Clips that were looked at while rules were chosen are
named: figures of them say nothing about unseen footage.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from bench.tracking.intervals import LEAST_BLOCKS
from bench.tracking.report import is_asked, share

DEVELOPMENT = (
    "{} was looked at while rules and thresholds were chosen: these are figures of development."
)
ALONE = "Nothing is compared: that takes foveated and another strategy on the same clips."


def sentences(report: Mapping[str, Any]) -> list[str]:
    """Return one for each target, budget and row of the policy, then one on the intervals."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in report["paired"]:
        if is_asked(row, report) and row["difference"] is not None:
            place = (row["target"], row["budget"], row["strategy"])
            groups.setdefault(place, []).append(row)
    if not groups:
        return [ALONE]
    places = sorted(groups, key=lambda place: (place[0], share(place[1])))
    found = [_sentence(*place, groups[place]) for place in places]
    looked_at = report.get("development", ())
    seen = [DEVELOPMENT.format(" and ".join(looked_at))] if looked_at else []
    worth = _worth([row["clips"] for pairs in groups.values() for row in pairs])
    return [*found, worth, *seen]


def _sentence(target: str, budget: str, strategy: str, pairs: Sequence[Mapping[str, Any]]) -> str:
    told = "; ".join(_difference(row) for row in pairs)
    counts = sorted({row["clips"] for row in pairs})
    clips = "one clip, indicative" if counts == [1] else f"{_range(counts)} clips"
    return f"{target} at {budget} of the pixels: {strategy} {told}, {clips}"


def _difference(row: Mapping[str, Any]) -> str:
    """Return one difference, and whether its interval includes zero.

    >>> _difference({"difference": 0.0131, "against": "spatial", "ci95": None})
    '+0.013 over spatial'
    >>> _difference({"difference": -0.02, "against": "oracle", "ci95": [-0.05, 0.01]})
    '-0.020 under oracle (-0.050 to +0.010, includes zero)'
    """
    value, ends = row["difference"], row["ci95"]
    shown = round(value, 3)
    way = "over" if shown > 0 else "under" if shown < 0 else "against"
    said = f"{_signed(value)} {way} {row['against']}"
    if not ends or None in ends:
        return said
    low, high = ends
    judged = "excludes zero" if low > 0 or high < 0 else "includes zero"
    return f"{said} ({_signed(low)} to {_signed(high)}, {judged})"


def _signed(value: float) -> str:
    """Return a difference with its sign; zero after rounding is always +0.000.

    >>> _signed(-0.0002), _signed(-0.02)
    ('+0.000', '-0.020')
    """
    return f"{round(value, 3) + 0.0:+.3f}"


def _worth(counts: Sequence[int]) -> str:
    if max(counts) == 1:
        return (
            "No interval is given: frames of one clip depend on one another, and other clips may "
            "show the opposite."
        )
    if max(counts) < LEAST_BLOCKS:
        return f"No interval is given: over fewer than {LEAST_BLOCKS} clips none holds its level."
    some = "Where there are enough clips, the" if min(counts) < LEAST_BLOCKS else "The"
    return f"{some} interval is of 95 %, paired, by Student's t over whole clips."


def _range(counts: Sequence[int]) -> str:
    return str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
