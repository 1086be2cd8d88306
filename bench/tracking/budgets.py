"""How each strategy spends a pixel budget, by the rules of the simulated sensor.

The budget of a strategy with a ROI is shared between context and ROI. At 1/4 and 1/8 the context
keeps a sixteenth of the pixels (0.25x, what the detector was trained on) and the ROI gets the rest;
at 1/16 both get 1/32, the context being 0.177x. The detector is retrained for none of them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from drivers.simulated.settings import SimulatedSensorSettings
from drivers.simulated.strategies import STRATEGIES, WITH_ROI, Sampling
from pipeline.errors import SettingsError
from pipeline.messages import Geometry

CONTEXT = "context"  # what a foveated row has beside its ROI, alone: less than the budget
PURSUIT = "pursuit"  # foveated by the rule of that name, as a row of its own
PLANNED = ("foveated", "round_robin")  # by the graph's own networks; the others need none of them
TOLERANCE = 0.01  # of the budget: the sensor's own count must be this near
LEAST = Fraction(1, 256)  # below it the context shows nothing that a detector could find
FINEST = 1_000_000  # denominator of the context's share, whose side is a rounded root
SHARES: Mapping[Fraction, tuple[float, float]] = {  # budget -> context's side, ROI's area
    Fraction(1, 4): (0.25, 3 / 16),
    Fraction(1, 8): (0.25, 1 / 16),
    Fraction(1, 16): (math.sqrt(1 / 32), 1 / 32),
    Fraction(1, 32): (math.sqrt(1 / 64), 1 / 64),
}


@dataclass(frozen=True, kw_only=True)
class Acquisition:
    """One strategy at one budget over a field of one size."""

    strategy: str
    budget: Fraction
    sampling: Sampling
    geometry: Geometry

    @property
    def looks(self) -> bool:
        """Whether it has a ROI."""
        return self.strategy in WITH_ROI

    def met_by(self, share: float) -> bool:
        """Whether a share of the pixels equals the budget, within `TOLERANCE`."""
        return abs(share / float(self.budget) - 1) <= TOLERANCE


def acquisition(strategy: str, budget: Fraction, size_px: tuple[int, int]) -> Acquisition:
    """Return what is read; raises `SettingsError` if that is not the budget within `TOLERANCE`."""
    if strategy not in (*STRATEGIES, CONTEXT):
        known = ", ".join((*STRATEGIES, CONTEXT, PURSUIT))
        raise SettingsError(f"strategies: expected {known}, got {strategy}")
    if strategy == "full":
        budget = Fraction(1)
    if budget < LEAST:
        raise SettingsError(f"budgets: expected at least {LEAST} of the pixels, got {budget}")
    if strategy == CONTEXT:
        context, _ = divided(budget)
        share = Fraction(context**2).limit_denominator(FINEST)
        return replace(_spent("spatial", share, size_px), strategy=CONTEXT)
    return _spent(strategy, budget, size_px)


def divided(budget: Fraction) -> tuple[float, float]:
    """Return the side of the context and the area of the ROI, shares of the field."""
    return SHARES.get(budget, (math.sqrt(budget / 2), float(budget / 2)))


def _spent(strategy: str, budget: Fraction, size_px: tuple[int, int]) -> Acquisition:
    """Return what is read, as `acquisition`, also of a context that is smaller than `LEAST`."""
    context, roi = divided(budget)
    settings = SimulatedSensorSettings(
        scene="soccer",
        strategy=strategy,  # type: ignore[arg-type]
        budget=float(budget),
        context_scale=context,
        roi_area=roi,
    )
    found = settings.sampling(size_px)
    how = Acquisition(
        strategy=strategy, budget=budget, sampling=found, geometry=settings.geometry(size_px)
    )
    used = found.emitted_px() / math.prod(size_px) / found.interval
    if not how.met_by(used):
        raise SettingsError(
            f"budgets: {strategy} at {budget} of {size_px[0]}x{size_px[1]} takes {used:.5f} of the "
            f"pixels, expected {float(budget):.5f} within {TOLERANCE:.0%}"
        )
    return how


def parsed(text: str) -> tuple[Fraction, ...]:
    """Parse budgets; raises `SettingsError`.

    >>> parsed("1/4,1/8")
    (Fraction(1, 4), Fraction(1, 8))
    """
    try:
        found = tuple(Fraction(part) for part in text.split(","))
    except (ValueError, ZeroDivisionError):
        raise SettingsError(f"budgets: expected fractions such as 1/4,1/8, got {text!r}") from None
    for budget in found:
        if not 0 < budget <= 1:
            raise SettingsError(f"budgets: expected above 0 to 1, got {budget}")
    return found
