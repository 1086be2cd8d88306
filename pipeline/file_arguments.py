"""Command-line arguments for graphs and sources: a shipped name or the path of a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from pipeline.graph.shipped import graph_names, graph_path, source_names, source_path


class _ShippedOrFile(click.Path):
    """A path, or a shipped name that is resolved to one; completes names and files."""

    def __init__(self, names: Callable[[], list[str]], find: Callable[[str], Path]) -> None:
        super().__init__(path_type=Path, dir_okay=False)
        self._names, self._find = names, find

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the path; raises `GraphError` for an unknown name."""
        return super().convert(self._find(value), param, ctx)

    def shell_complete(self, ctx: Any, param: Any, incomplete: str) -> list[CompletionItem]:
        """Return matching names or, if there are none, files (bash cannot offer both)."""
        names = [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
        return names or super().shell_complete(ctx, param, incomplete)


GRAPH_FILE = _ShippedOrFile(graph_names, graph_path)
SOURCE_FILE = _ShippedOrFile(source_names, source_path)
