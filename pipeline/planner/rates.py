"""Rates in sentences that say what would fit."""

import math


def below(rate_hz: float) -> str:
    """Return a rate with three significant digits, rounded down: what it names fits as well.

    >>> below(57.789), below(0.51279), below(12345.6), below(0.0)
    ('57.7', '0.512', '12300', '0')
    """
    if rate_hz <= 0:
        return "0"
    step = 10.0 ** (math.floor(math.log10(rate_hz)) - 2)
    return f"{math.floor(rate_hz / step + 1e-9) * step:.10g}"
