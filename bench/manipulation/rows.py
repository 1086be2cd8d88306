"""Rows of the table: strategies and budgets in, changes of the graph's robot out.

A sixteenth is the paper's division: a context of 0.17x and a ROI of a sixteenth of the field at
0.7x. At the other budgets context and ROI have the same shares of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

from drivers.simulated.strategies import STRATEGIES, WITH_ROI
from pipeline.errors import SettingsError
from pipeline.graph.plan import Plan

ROBOT = "robot"  # the node
ROI_SCALE = 0.7
SHARES = {  # budget -> context's side, ROI's area
    Fraction(1, 4): (0.34, 0.25),
    Fraction(1, 8): (0.24, 0.125),
    Fraction(1, 16): (0.17, 0.0625),
    Fraction(1, 32): (0.12, 0.03125),
    Fraction(1, 64): (0.085, 0.015625),
    Fraction(1, 128): (0.06, 0.0078125),
}
CONTEXT = "context"  # what a row with a ROI has beside it, alone: less than the budget


@dataclass(frozen=True, kw_only=True)
class Row:
    """One strategy at one budget."""

    strategy: str
    budget: Fraction

    @property
    def changes(self) -> tuple[str, ...]:
        """Settings of the robot, as `--set` takes them."""
        context, roi_area = SHARES.get(self.budget, (0.0, 0.0))
        strategy, budget = self.strategy, float(self.budget)
        if strategy == CONTEXT:
            strategy, budget = "spatial", context**2
        found = {"strategy": strategy, "budget": budget}
        if strategy in WITH_ROI:
            found |= {"context_scale": context, "roi_area": roi_area, "roi_scale": ROI_SCALE}
        else:  # else the sensor would check the graph's own ROI against the budget
            found |= {"context_scale": 0.01, "roi_area": 0.0001, "roi_scale": 1.0}
        return tuple(f"{ROBOT}.{name}={value}" for name, value in found.items())


def rows_of(strategies: Iterable[str], budgets: Iterable[Fraction], plan: Plan) -> list[Row]:
    """Return the rows; `full` has no budget. Raises `SettingsError` for what cannot be met.

    `all` are those that the graph can have: `foveated` needs something that commands the ROI, and
    `oracle` the name of the object on which the ROI sits.
    """
    aimed = "schedule" in plan.inputs(ROBOT)
    named = "oracle_label" in plan.node(ROBOT).settings.get("options", {})
    without = {"full"} | (set() if aimed else {"foveated"}) | (set() if named else {"oracle"})
    known = ["full", CONTEXT, *(s for s in STRATEGIES if s not in without)]
    asked = [name for each in strategies for name in (known if each == "all" else [each])]
    found: list[Row] = []
    for name in dict.fromkeys(asked):
        if name not in (*STRATEGIES, CONTEXT):
            raise SettingsError(f"strategies: expected all, {', '.join(known)}, got {name}")
        if name == "foveated" and not aimed:
            raise SettingsError("strategies: foveated needs a graph that commands the ROI")
        if name == "oracle" and not named:
            raise SettingsError(
                f"strategies: oracle needs the object that its ROI follows, as --set "
                f"{ROBOT}.oracle_label=peg, got none"
            )
        if name == "full":
            found.append(Row(strategy=name, budget=Fraction(1)))
            continue
        for budget in budgets:
            if name in (*WITH_ROI, CONTEXT) and budget not in SHARES:
                told = ", ".join(map(str, SHARES))
                raise SettingsError(f"budgets: {name} has {told}, got {budget}")
            found.append(Row(strategy=name, budget=budget))
    return found


def parsed(text: str) -> tuple[Fraction, ...]:
    """Parse budgets; raises `SettingsError`.

    >>> parsed("1/8,1/16")
    (Fraction(1, 8), Fraction(1, 16))
    """
    try:
        found = tuple(Fraction(part) for part in text.split(","))
    except (ValueError, ZeroDivisionError):
        found = ()
    if not found or not all(0 < budget < 1 for budget in found):
        raise SettingsError(f"budgets: expected fractions such as 1/8,1/16, got {text!r}")
    return found
