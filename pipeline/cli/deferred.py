"""A command that is imported when it is used: a name and a summary until then."""

from importlib import import_module
from typing import Any

import click


class Deferred(click.Command):
    """Stands for the command at an import path; everything but its summary is that command's."""

    def __init__(self, name: str, path: str, summary: str) -> None:
        super().__init__(name, help=summary)
        self.path = path

    def loaded(self) -> click.Command:
        """The command."""
        module, _, name = self.path.partition(":")
        found: click.Command = getattr(import_module(module), name)
        return found

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:  # fmt: skip
        """A context of the command itself, which is what will be invoked and completed."""
        return self.loaded().make_context(info_name, args, parent, **extra)
