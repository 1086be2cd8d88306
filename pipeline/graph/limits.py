"""The limits of every number in a graph, in one table.

`pipeline.graph.spec` applies it to files and `pipeline.graph.plan` to plans; the JSON Schema for
editors contains it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec

from pipeline.errors import FoveaError, GraphError
from pipeline.providers import MOST_THREADS
from pipeline.wording import shown

MOST_NODES, MOST_EDGES = 128, 512
MOST_FRAMES = 1_000_000_000  # largest frame number of an order: a year at 30 Hz
DAY_S = 86400.0
Word = Annotated[str, msgspec.Meta(max_length=200)]
FrameCount = Annotated[int, msgspec.Meta(ge=0, le=MOST_FRAMES)]
SomeFrames = Annotated[int, msgspec.Meta(ge=1, le=MOST_FRAMES)]
BudgetMs = Annotated[float, msgspec.Meta(ge=0, le=1000 * DAY_S)]


@dataclass(frozen=True)
class Limit:
    """The range of a number, ends included."""

    low: float
    high: float
    whole: bool = False

    def check(self, value: object, where: str, error: type[FoveaError] = GraphError) -> None:
        """Raise `error` beginning with `where` unless the value is a number in the range.

        >>> Limit(1, 64, whole=True).check(65, "work.threads")
        Traceback (most recent call last):
        pipeline.errors.GraphError: work.threads: expected 1 to 64, got 65
        """
        number = isinstance(value, int if self.whole else (int, float))
        if not number or isinstance(value, bool):
            kind = "a whole number, " if self.whole else "a number, "
        elif self.low <= value <= self.high:  # type: ignore[operator]  # nor for nan
            return
        else:
            kind = ""
        raise error(f"{where}: expected {kind}{self.low:g} to {self.high:g}, got {shown(value)}")

    def read(self, value: object, where: str) -> int | float:
        """Convert a number of a file: 3.0 is a whole number; raises as `check` does.

        >>> Limit(1, 64, whole=True).read(3.0, "work.threads"), Limit(0, 9).read(2, "work.stall_s")
        (3, 2.0)
        """
        if self.whole and isinstance(value, float) and value.is_integer():
            value = int(value)
        self.check(value, where)
        assert isinstance(value, (int, float))
        return value if self.whole else float(value)

    def schema(self) -> dict[str, Any]:
        """Return the range as JSON Schema."""
        kind = "integer" if self.whole else "number"
        low, high = (int(v) if float(v).is_integer() else v for v in (self.low, self.high))
        return {"type": kind, "minimum": low, "maximum": high}


Limits = Mapping[str, Limit]
NODE: Limits = {
    "threads": Limit(1, MOST_THREADS, whole=True),
    "stall_s": Limit(0.1, DAY_S),
    "start_s": Limit(0.1, DAY_S),
    "memory_mb": Limit(0, 1e7),
}
RESTART: Limits = {
    "backoff_s": Limit(0.001, DAY_S),
    "window_s": Limit(0.1, DAY_S),
    "most": Limit(0, 10_000, whole=True),
}
EDGE: Limits = {
    "depth": Limit(1, 64, whole=True),
    "wait_ms": Limit(0, 1000 * DAY_S),
    "max_age_ms": Limit(0, 1000 * DAY_S),
}


def check_numbers(
    of: object, limits: Limits, where: str, error: type[FoveaError] = GraphError
) -> None:
    """Raise `error` unless every number of an object is within its limits."""
    for name, limit in limits.items():
        limit.check(getattr(of, name), f"{where}.{name}" if where else name, error)
