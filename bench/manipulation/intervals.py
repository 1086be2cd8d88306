"""Intervals of 95 %: counts of trials in, those of shares and of paired differences out."""

import math
from collections.abc import Sequence

Z = 1.959964  # of a two-sided interval of 95 %
METHOD = "95 %: Wilson for shares, Bonett and Price for differences paired by seed"


def wilson(count: int, trials: int) -> tuple[float, float]:
    """Return the interval of a share; (0, 1) without trials.

    >>> [round(v, 3) for v in wilson(5, 10)], [round(v, 3) for v in wilson(0, 100)]
    ([0.237, 0.763], [0.0, 0.037])
    """
    if not trials:
        return 0.0, 1.0
    share, weight = count / trials, Z**2 / trials
    middle = (share + weight / 2) / (1 + weight)
    arm = Z * math.sqrt(share * (1 - share) / trials + weight / (4 * trials)) / (1 + weight)
    # rounding must not leave the share outside
    return max(0.0, min(share, middle - arm)), min(1.0, max(share, middle + arm))


def paired(ours: Sequence[bool], theirs: Sequence[bool]) -> tuple[float, float, float]:
    """Return the difference of two shares over the same trials, and its interval.

    >>> [round(v, 3) for v in paired([True] * 9 + [False], [True] * 5 + [False] * 5)]
    [0.4, -0.02, 0.686]
    """
    trials = len(ours)
    won = sum(a and not b for a, b in zip(ours, theirs, strict=True))
    lost = sum(b and not a for a, b in zip(ours, theirs, strict=True))
    if not trials:
        return 0.0, -1.0, 1.0
    # one trial more on either side: the plain interval is empty where nothing was lost
    up, down = (won + 1) / (trials + 2), (lost + 1) / (trials + 2)
    arm = Z * math.sqrt((up + down - (up - down) ** 2) / (trials + 2))
    return (won - lost) / trials, max(-1.0, up - down - arm), min(1.0, up - down + arm)
