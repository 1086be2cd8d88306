"""Rows of the table: strategies and budgets in, changes of the graph out."""

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from bench.tracking.budgets import CONTEXT, acquisition
from drivers.simulated.strategies import WITH_ROI
from pipeline.errors import SettingsError

FULL = "full"
FOVEATED = "foveated"
EXPOSURE = "exposure"
LEARNED = "operators.policy:ReadingPolicy"
POLICIES = {  # rows in which a policy aims the ROI; empty: the graph's own
    FOVEATED: "",
    "greedy": "operators.policy:GreedyReadingPolicy",
    "oracle": "bench.reading.oracle:Oracle",
}
PARTS = {  # what --replace takes: the node and what knows the truth in its place
    "detections": ("saliency", "bench.reading.known:TrueDetections"),
    "reader": ("reader", "bench.reading.known:TrueReader"),
}
INPUTS = ("features", "percept", "roi")  # what --without takes, of the policy
ALL = (
    *("full", "oracle", "foveated", "greedy", "context", "centred", "round_robin"),
    *("spatial", "temporal", EXPOSURE),
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One strategy at one budget."""

    strategy: str
    budget: Fraction
    policy: str = ""  # an ONNX file in place of the graph's own policy
    replaced: str = ""  # one of `PARTS`
    without: str = ""  # one of `INPUTS`

    @property
    def name(self) -> str:
        """The strategy, and what is different about it."""
        known = f", true {self.replaced}" if self.replaced else ""
        return self.strategy + known + (f" without {self.without}" if self.without else "")

    @property
    def aimed(self) -> bool:
        """Whether a policy aims the ROI."""
        return self.strategy in POLICIES

    def changes(self, size_px: tuple[int, int]) -> tuple[str, ...]:
        """Return settings of the graph, as `--set` takes them.

        Raises `SettingsError` for a budget that cannot be met.
        """
        sensor = FOVEATED if self.aimed else self.strategy
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
        if self.replaced != "reader":
            found["reader.reads"] = "roi" if looks else "context"
        return tuple(f"{name}={value}" for name, value in found.items())


def rows_of(
    strategies: Iterable[str], budgets: Sequence[Fraction], size_px: tuple[int, int], *,
    policy: str = "", replaced: Iterable[str] = (), without: Iterable[str] = (),
) -> list[Row]:  # fmt: skip
    """Return the rows; `full` has no budget. Raises `SettingsError` for what cannot be met."""
    asked = [name for each in strategies for name in (ALL if each == "all" else [each])]
    known("strategies", asked, ALL)
    parts = known("replace", replaced, PARTS)
    inputs = known("without", without, INPUTS)
    found: list[Row] = []
    for name in dict.fromkeys(asked):
        for budget in [Fraction(1)] if name == FULL else budgets:
            row = Row(strategy=name, budget=budget, policy=policy if name == FOVEATED else "")
            found.append(row)
            if name == FOVEATED:
                found += [dataclasses.replace(row, replaced=part) for part in parts]
                found += [dataclasses.replace(row, without=each) for each in inputs]
    for row in found:
        row.changes(size_px)
    return found


def known(option: str, given: Iterable[str], names: Collection[str]) -> list[str]:
    """Return what is given, each once; raises `SettingsError` for what has no such name."""
    found = list(dict.fromkeys(given))
    for name in found:
        if name not in names:
            every = "all, " if option == "strategies" else ""
            raise SettingsError(f"{option}: expected {every}{', '.join(names)}, got {name}")
    return found
