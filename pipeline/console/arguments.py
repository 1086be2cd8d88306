"""Words of a command line as numbers and values, each held to what can be meant by it."""

import math
from typing import Any

import click

from pipeline.graph.limits import DAY_S, MOST_FRAMES
from pipeline.graph.overlay import read_value, shown_change

MOST_LINES = 1_000_000


class Finite(click.FloatRange):
    """A number within a range; neither infinite nor none at all."""

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """The number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is no finite number.", param, ctx)
        return number


FRAMES = click.IntRange(1, MOST_FRAMES)
FRAMES_OR_NONE = click.IntRange(0, MOST_FRAMES)
LINES = click.IntRange(0, MOST_LINES)
INTERVAL_S = Finite(0.1, DAY_S)
DURATION_S = Finite(0, 1000 * DAY_S, min_open=True)
BUDGET_MS = Finite(0, 1000 * DAY_S)


def named_value(word: str) -> tuple[str, Any]:
    """Name and value of `NAME=VALUE`; raises `click.UsageError` or `GraphError`."""
    name, equals, text = word.partition("=")
    if not equals or not name:
        raise click.UsageError(f"{shown_change(word)}: expected NAME=VALUE")
    return name, read_value(text, name)
