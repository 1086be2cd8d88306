"""Rows of the table: strategies and budgets in, changes of the graph out."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from bench.tracking.budgets import CONTEXT, acquisition
from drivers.simulated.strategies import WITH_ROI
from pipeline.errors import SettingsError

FULL = "full"
POLICIES = {  # rows in which a policy aims the ROI; empty: the graph's own
    "foveated": "",
    "greedy": "operators.policy:GreedyReadingPolicy",
    "oracle": "bench.reading.oracle:Oracle",
}
ALL = (
    *("full", "oracle", "foveated", "greedy", "context", "centred", "round_robin"),
    *("spatial", "temporal", "exposure"),
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One strategy at one budget."""

    strategy: str
    budget: Fraction

    @property
    def aimed(self) -> bool:
        """Whether a policy aims the ROI."""
        return self.strategy in POLICIES

    def changes(self, size_px: tuple[int, int]) -> tuple[str, ...]:
        """Return settings of the graph, as `--set` takes them.

        Raises `SettingsError` for a budget that cannot be met.
        """
        sensor = "foveated" if self.aimed else self.strategy
        how = acquisition(sensor, self.budget, size_px)
        if sensor == CONTEXT:
            sensor = "spatial"
        wide, high = size_px
        found: dict[str, object] = {"capture.strategy": sensor, "capture.budget": float(how.budget)}
        looks = sensor in WITH_ROI
        if looks:
            roi = how.sampling.window_px
            found["capture.context_scale"] = how.sampling.context_px[0] / wide
            found["capture.roi_area"] = roi[0] * roi[1] / (wide * high)
        else:  # else the sensor would check the graph's own ROI against the budget
            found |= {"capture.context_scale": 0.01, "capture.roi_area": 0.0001}
        found["reader.reads"] = "roi" if looks else "context"
        return tuple(f"{name}={value}" for name, value in found.items())


def rows_of(
    strategies: Iterable[str], budgets: Sequence[Fraction], size_px: tuple[int, int]
) -> list[Row]:
    """Return the rows; `full` has no budget. Raises `SettingsError` for what cannot be met."""
    asked = [name for each in strategies for name in (ALL if each == "all" else [each])]
    found: list[Row] = []
    for name in dict.fromkeys(asked):
        if name not in ALL:
            raise SettingsError(f"strategies: expected all, {', '.join(ALL)}, got {name}")
        shares = [Fraction(1)] if name == FULL else budgets
        found += [Row(strategy=name, budget=budget) for budget in shares]
    for row in found:
        row.changes(size_px)
    return found
