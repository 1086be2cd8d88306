"""Conclusions of an evaluation as sentences: paired differences of the policy to the others.

One clip has no interval, because its frames depend on one another and nothing can be redrawn from
one clip. Over few clips an interval is too narrow: of simulated "95 %" intervals .81 contained the
true value with 4 clips, .85 with 6, .94 with 30.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from bench.tracking.report import is_asked, share

FEW_CLIPS = 10  # below it an interval is said to be too narrow
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
    return [*found, _worth([row["clips"] for pairs in groups.values() for row in pairs])]


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
    some = "Where there are several clips, the interval" if min(counts) == 1 else "The interval"
    worth = f"{some} is of 95 %, paired, by drawing whole clips"
    if min(n for n in counts if n > 1) < FEW_CLIPS:
        return f"{worth}; over fewer than {FEW_CLIPS} of them it is too narrow."
    return f"{worth}."


def _range(counts: Sequence[int]) -> str:
    return str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
