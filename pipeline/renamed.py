"""Renamed options: using the old name is an error that names the new one."""

from collections.abc import Callable
from typing import Any

import click


def renamed_option(old: str, new: str, *, flag: bool = False) -> Callable[..., Any]:
    """A hidden option of a command that raises `click.UsageError` when it is given."""

    def refuse(_context: click.Context, _option: click.Parameter, given: object) -> None:
        if given:
            raise click.UsageError(f"{old}: renamed; expected {new}")

    more: dict[str, Any] = {"is_flag": True} if flag else {"multiple": True}
    name = f"renamed_{old.strip('-').replace('-', '_')}"  # an argument may have the other
    return click.option(old, name, hidden=True, expose_value=False, callback=refuse, **more)
