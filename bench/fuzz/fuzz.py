"""The command of the fuzzers: it counts cases, refusals, and failures (none are expected).

python -m bench.fuzz graphs --count 10000; python -m bench.fuzz orders --count 10000;
python -m bench.fuzz wire --count 1000000; python -m bench.fuzz usb --count 1000000;
python -m bench.fuzz genicam FILE… --count 10000
"""

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from bench import machine
from bench.fuzz.genicam import fuzz_genicam
from bench.fuzz.graphs import fuzz_graphs
from bench.fuzz.orders import fuzz_orders
from bench.fuzz.tally import Tally
from bench.fuzz.usb import fuzz_usb
from bench.fuzz.wire import fuzz_wire
from bench.options import JSON, Bench
from pipeline.graph.shipped import graph_path

SHIPPED = tuple(map(graph_path, ("tracking", "multi_host")))


@click.group()
def fuzz() -> None:
    """Fuzz everything that parses untrusted input."""


def options(count: int) -> Callable[..., Any]:
    """Add the options for the number of cases, the seed and the output file."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        command = click.option("--seed", default=0, show_default=True)(command)
        return JSON(
            click.option("--count", default=count, show_default=True, type=click.IntRange(1))(
                command
            )
        )

    return decorate


@fuzz.command(cls=Bench)
@click.argument("graphs", nargs=-1, type=click.Path(path_type=Path))
@options(10_000)
def graphs(graphs: Sequence[Path], count: int, seed: int, path: Path | None) -> None:
    """Load malformed versions of GRAPHS (default: the shipped ones)."""
    with tempfile.TemporaryDirectory() as folder:
        tally = fuzz_graphs(graphs or SHIPPED, count, Path(folder), seed=seed)
    tell("graphs", tally, seed, path)


@fuzz.command(cls=Bench)
@options(10_000)
def orders(count: int, seed: int, path: Path | None) -> None:
    """Send malformed orders to a small running graph and to a node."""
    with tempfile.TemporaryDirectory() as folder:
        tally = fuzz_orders(count, Path(folder), seed=seed)
    tell("orders", tally, seed, path)


@fuzz.command(cls=Bench)
@options(1_000_000)
def wire(count: int, seed: int, path: Path | None) -> None:
    """Decode malformed bytes."""
    tell("wire", fuzz_wire(count, seed=seed), seed, path)


@fuzz.command(cls=Bench)
@options(1_000_000)
def usb(count: int, seed: int, path: Path | None) -> None:
    """Read malformed blocks of the USB board's protocol."""
    tell("usb", fuzz_usb(count, seed=seed), seed, path)


@fuzz.command(cls=Bench)
@click.argument(
    "descriptions", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False)
)
@options(10_000)
def genicam(descriptions: Sequence[Path], count: int, seed: int, path: Path | None) -> None:
    """Read malformed DESCRIPTIONS of cameras, GenICam XML (default: a small one of its own)."""
    tell("genicam", fuzz_genicam(count, descriptions, seed=seed), seed, path)


def tell(what: str, tally: Tally, seed: int, path: Path | None) -> None:
    """Print the figures, write them with their origin, and exit with status 1 after a failure."""
    figures = {**asdict(tally), "kinds": dict(tally.kinds)}  # asdict makes a Counter of pairs
    examples = figures.pop("examples")
    click.echo(json.dumps({what: figures}, indent=1))
    for example in examples:
        click.echo(example, err=True)
    if path:
        whole = {"fuzz": what, "seed": seed, **figures, **machine.facts()}
        path.write_text(json.dumps(whole, indent=1))
    if not tally.sound:
        sys.exit(1)
