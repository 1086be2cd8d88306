"""Learning-rate schedule: a step's number -> its learning rate."""

import math


def warmed_cosine(
    step: int, *, peak: float, warmup: int, steps: int, lowest: float = 0.01
) -> float:
    """Linear warm-up over `warmup` steps, then half a cosine down to a share `lowest` of the peak.

    >>> [warmed_cosine(step, peak=1.0, warmup=2, steps=4, lowest=0.0) for step in range(4)]
    [0.5, 1.0, 1.0, 0.5]
    """
    if step < warmup:
        return peak * (step + 1) / warmup
    share = min(1.0, (step - warmup) / max(1, steps - warmup))
    return peak * (lowest + (1 - lowest) * (1 + math.cos(math.pi * share)) / 2)
