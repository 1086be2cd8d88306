"""`fovea sensors`: list what is attached, test one sensor, print the udev rule."""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import click

from drivers.attached.child import FAILED, FAMILY, Child
from drivers.attached.report import figures_line, listing, shown_address, without_credentials
from drivers.attached.rules import rules
from drivers.attached.search import LIMIT_S, search
from drivers.attached.subject import FORMS
from pipeline import errors
from pipeline.cli.arguments import JSON, Finite, print_json
from pipeline.errors import DriverError, FoveaError

TRIED = "drivers.attached.trial:tried"
CHECK_S, RUN_S = 60.0, 5.0
LONGEST_S = 3600.0
MARKS = {"ok": "ok      ", "wrong": "wrong   ", "skipped": "skipped "}


@click.group("sensors", invoke_without_command=True)
@JSON
@click.option(
    "--timeout-s", default=LIMIT_S, show_default=True, type=Finite(0.1, LONGEST_S),
    help="Longest search for each kind.",
)  # fmt: skip
@click.pass_context
def sensors_command(context: click.Context, as_json: bool, timeout_s: float) -> None:
    """List the attached sensors and what each can do; test one on the desk.

    Dual-stream boards on USB, GigE Vision and USB3 Vision cameras, webcams.
    """
    if context.invoked_subcommand is not None:
        return
    found = search(limit_s=timeout_s)
    if as_json:
        print_json({"kinds": [asdict(kind) for kind in found]})
        return
    for line in listing(found):
        click.echo(line)


@sensors_command.command("rules")
def rules_command() -> None:
    """Print the udev rule that lets the user open boards and USB3 Vision cameras."""
    click.echo(rules(), nl=False)


@sensors_command.command("test", help=f"Run the checks of a sensor's contract on NAME: {FORMS}.")
@click.argument("name")
@click.option("--set", "changes", multiple=True, metavar="OPTION=VALUE")
@click.option(
    "--seconds", default=RUN_S, show_default=True, type=Finite(0.1, LONGEST_S),
    help="Length of the run in real time.",
)  # fmt: skip
@click.option(
    "--timeout-s", default=CHECK_S, show_default=True, type=Finite(0.1, LONGEST_S),
    help="Longest time for one check.",
)  # fmt: skip
@JSON
def test_command(
    name: str, changes: tuple[str, ...], seconds: float, timeout_s: float, as_json: bool
) -> None:
    """Run the checks of a sensor's contract on one sensor; exit status 1 when one fails."""
    results: list[dict[str, Any]] = []
    subject: dict[str, Any] = {}
    for told in trial(name, changes, seconds=seconds, limit_s=timeout_s + seconds):
        if "sensor" in told:
            subject = without_credentials(told)
        elif "check" in told:
            results.append(told)
        if not as_json:
            _show(told)
    shown = shown_address(name)
    good = sum(result["verdict"] != "wrong" for result in results)
    passed = bool(results) and good == len(results)
    if as_json:
        print_json({"name": shown, **subject, "passed": passed, "checks": results})
    else:
        verdict = "the contract is kept" if passed else "the contract is not kept"
        click.echo(f"{shown}: {good} of {len(results)} checks: {verdict}")
    if not passed:
        sys.exit(1)


def trial(
    name: str, changes: tuple[str, ...], *, seconds: float, limit_s: float
) -> Iterator[dict[str, Any]]:
    """Yield what the child tells; what it does not survive ends in a verdict `wrong`.

    Raises the `FoveaError` of a name or settings that are none.
    """
    under_way = ""
    words = (name, json.dumps(changes), f"{seconds:g}")
    with Child(TRIED, *words, limit_s=limit_s) as child:
        try:
            while (told := child.next()) is not None:
                if FAILED in told:
                    raise _refusal(told)
                under_way = told.get("begins", under_way)
                yield told
                if "check" in told:
                    under_way = ""
        except DriverError as error:
            if not under_way:
                raise
            yield {"check": under_way, "verdict": "wrong", "why": str(error), "figures": {},
                   "seconds": limit_s}  # fmt: skip


def _refusal(told: dict[str, Any]) -> FoveaError:
    """Return the error that a child met before the first check."""
    family: type[FoveaError] = getattr(errors, told[FAMILY], DriverError)
    return family(told[FAILED])


def _show(told: dict[str, Any]) -> None:
    """Print a check as it begins, where someone watches, and its verdict."""
    watched = sys.stdout.isatty()
    if "begins" in told and watched:
        click.echo(f"…       {told['begins']}", nl=False)
    if "check" in told:
        words = told["why"] or figures_line(told["figures"])
        start = "\r" if watched else ""
        line = f"{MARKS[told['verdict']]}{told['check']:<52} {told['seconds']:5.1f} s  {words}"
        click.echo(f"{start}{line}".rstrip())
