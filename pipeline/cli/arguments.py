"""Arguments that several commands share: graphs, nodes, numbers, values, `--json`."""

import math
from collections.abc import Callable
from typing import Any

import click
import msgspec
from click.shell_completion import CompletionItem

from pipeline.graph.limits import DAY_S, MOST_FRAMES
from pipeline.graph.overlay import read_value, shown_change

MOST_LINES = 1_000_000


class Finite(click.FloatRange):
    """A finite number within a range."""

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """Return the number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is no finite number.", param, ctx)
        return number


class _Running(click.types.StringParamType):
    """The name of a running graph, with completion."""

    name = "graph"

    def shell_complete(self, ctx: Any, param: Any, incomplete: str) -> list[CompletionItem]:
        """Return matching names."""
        from pipeline.client.find import graphs

        return [CompletionItem(name) for name in graphs() if name.startswith(incomplete)]


RUNNING = _Running()
FRAMES = click.IntRange(1, MOST_FRAMES)
FRAMES_OR_NONE = click.IntRange(0, MOST_FRAMES)
LINES = click.IntRange(0, MOST_LINES)
INTERVAL_S = Finite(0.1, DAY_S)
DURATION_S = Finite(0, 1000 * DAY_S, min_open=True)
BUDGET_MS = Finite(0, 1000 * DAY_S)


def named_value(word: str) -> tuple[str, Any]:
    """Parse `NAME=VALUE`; raises `click.UsageError` or `GraphError`."""
    name, equals, text = word.partition("=")
    if not equals or not name:
        raise click.UsageError(f"{shown_change(word)}: expected NAME=VALUE")
    return name, read_value(text, name)


JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
GRAPH = click.argument("graph", type=RUNNING)


def second(name: str, metavar: str = "", *, form: str) -> Callable[..., Any]:
    """Declare the argument after GRAPH; without it, an error shows the expected `form`.

    The error is a `click.UsageError`.
    """

    def check(context: click.Context, _parameter: click.Parameter, word: str | None) -> str:
        if word is None and not context.resilient_parsing:
            first = context.params.get("graph")
            only = f", got {shown_change(str(first))} alone" if first else ""
            raise click.UsageError(
                f"Missing argument {(metavar or name.upper())!r}: expected "
                f"`fovea {context.info_name} {form}`{only}"
            )
        return word or ""

    return click.argument(name, required=False, metavar=metavar or name.upper(), callback=check)


def print_json(value: Any, *, compact: bool = False) -> None:
    """Print a value, which may contain structs, as JSON: indented, or on one line."""
    data = msgspec.json.encode(value, enc_hook=str)
    click.echo(data if compact else msgspec.json.format(data, indent=1))
