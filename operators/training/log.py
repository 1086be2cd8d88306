"""A training's log.csv: a line of step, seconds and figures every `EVERY` steps."""

from collections.abc import Iterable
from pathlib import Path

EVERY = 20


def note(log: Path, step: int, elapsed_s: float, figures: Iterable[float]) -> None:
    """Add a line."""
    with log.open("a") as file:
        file.write(",".join([f"{step},{elapsed_s:.0f}", *(f"{v:.4f}" for v in figures)]) + "\n")


def shorten(log: Path, step: int) -> None:
    """Forget what was logged after the checkpoint that a training goes on from."""
    if log.exists():
        told = [(line.partition(",")[0], line) for line in log.read_text().splitlines()]
        # what is no number was torn when the machine went off
        kept = [line for number, line in told if number.isdigit() and int(number) <= step]
        log.write_text("".join(f"{line}\n" for line in kept))
