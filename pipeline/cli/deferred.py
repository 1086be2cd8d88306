"""A command that is imported on first use; until then it has only a name and a summary."""

from importlib import import_module
from typing import Any

import click


class Deferred(click.Command):
    """A placeholder for the command at an import path; only the summary is its own."""

    def __init__(self, name: str, path: str, summary: str) -> None:
        super().__init__(name, help=summary)
        self.path = path

    def loaded(self) -> click.Command:
        """Import and return the command."""
        module, _, name = self.path.partition(":")
        found: click.Command = getattr(import_module(module), name)
        return found

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:  # fmt: skip
        """Return a context of the imported command, for calls and completion."""
        return self.loaded().make_context(info_name, args, parent, **extra)
