"""Measure sending a picture between two processes, by fovea's bus and by other transports.

`python -m bench.bus [--json FILE] [--count N] [--rate-hz R] [--sizes N,N] [--peers] [--side-env F]`

Every contestant is a script of `bench.peers`, measured by `bench.peers.ruler`. In each round all
contestants run once per size, in shuffled order, so that other load on the machine affects all of
them. The peers' libraries have an environment of their own, which `--peers` makes if it is absent.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from bench.bus_figures import Result, summarise, table
from bench.machine import facts
from bench.options import JSON

ROOT = Path(__file__).resolve().parent.parent
SIZES = (65_536, 2_341_920, 9_367_680, 18_735_360)  # 2040x1148, 4080x2296, the same in 16 bit
REQUIREMENTS = ("iceoryx2==0.10.*", "ezmsg==3.9.*", "dora-rs==1.1.*", "dora-rs-cli==1.1.*", "numpy")
FAREWELL_S = 2.0  # time for the descendants of a contestant to end after it
LIMIT_S = 120.0  # of one turn, in addition to the time of its messages


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """A script and the environment it runs in."""

    module: str
    label: str
    ours: bool = False  # runs where fovea is installed, not in the peers' environment
    needs: str = ""  # module that must be importable there


CONTESTANTS = (
    Contestant(module="bare", label="floor", ours=True),
    Contestant(module="fovea_bus", label="fovea", ours=True),
    Contestant(module="zenoh_bytes", label="zenoh, bytes", ours=True),
    Contestant(module="iceoryx2_slices", label="iceoryx2", needs="iceoryx2"),
    Contestant(module="ezmsg_units", label="ezmsg", needs="ezmsg.core"),
    Contestant(module="dora_nodes", label="dora, tuned", needs="dora"),
)


@click.command()
@JSON
@click.option("--count", default=200, show_default=True, type=click.IntRange(1), help="Per size.")
@click.option("--rounds", default=4, show_default=True, type=click.IntRange(1))
@click.option("--rate-hz", default=30.0, show_default=True, type=click.FloatRange(0.1))
@click.option("--sizes", default=",".join(map(str, SIZES)), show_default=True, metavar="N,N…")
@click.option("--seed", default=7, show_default=True, help="Of the order of turns.")
@click.option("--peers/--no-peers", default=False, help="Make the peers' environment if absent.")
@click.option("--side-env", type=click.Path(path_type=Path), help="The peers' environment.")
def main(
    path: Path | None, count: int, rounds: int, rate_hz: float, sizes: str, seed: int,
    peers: bool, side_env: Path | None,
) -> None:  # fmt: skip
    """Measure sending a picture between two processes."""
    console = Console()
    side = side_env or Path.home() / ".cache" / "fovea" / "peers"
    if peers:
        make_environment(side, console)
    chosen = [c for c in CONTESTANTS if is_installed(c, side)]
    if missing := [c.label for c in CONTESTANTS if c not in chosen]:
        console.print(f"not installed (see --peers): {', '.join(missing)}")
    lengths = read_sizes(sizes)
    each = -(-count // rounds)
    turns = schedule([c.module for c in chosen], lengths, rounds, seed)
    results, failures = take_turns(turns, each, rate_hz, side, console)
    figures = summarise(results)
    labels = {c.module: c.label for c in CONTESTANTS}
    for nbytes in lengths:
        console.print(table(figures, nbytes, labels))
    for sentence in failures:
        console.print(f"[red]{sentence}[/red]")
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({
            "bench": "bus", **facts(), "seed": seed, "rounds": rounds, "count_per_round": each,
            "rate_hz": rate_hz, "figures": figures, "failures": failures,
        }, indent=1))  # fmt: skip


def read_sizes(words: str) -> list[int]:
    """Parse sizes in bytes; raises `click.BadParameter` for an invalid one.

    >>> read_sizes("128, 4096")
    [128, 4096]
    """
    try:
        sizes = [int(word) for word in words.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"--sizes: expected whole numbers, got {words!r}") from error
    if min(sizes) < 128:
        raise click.BadParameter(f"--sizes: must be at least 128 bytes, got {min(sizes)}")
    return sizes


def schedule(modules: list[str], sizes: list[int], rounds: int, seed: int) -> list[tuple[str, int]]:
    """Return turns (contestant, bytes): each round has every contestant once per size, shuffled."""
    rng = random.Random(seed)
    turns = []
    for _ in range(rounds):
        for nbytes in sizes:
            turns += [(module, nbytes) for module in rng.sample(modules, len(modules))]
    return turns


def take_turns(
    turns: list[tuple[str, int]], count: int, rate_hz: float, side: Path, console: Console
) -> tuple[list[Result], list[str]]:
    """Run every turn; return results, and a sentence for each failure."""
    results, failures = [], []
    columns = (
        SpinnerColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=len(turns))
        for module, nbytes in turns:
            progress.update(task, description=f"{module}, {nbytes} bytes")
            try:
                results.append(run_one(module, nbytes, count, rate_hz, side))
            except (subprocess.SubprocessError, ValueError) as error:
                failures.append(f"{module}, {nbytes} bytes: no result: {error}")
            progress.advance(task)
    return results, failures


def run_one(module: str, nbytes: int, count: int, rate_hz: float, side: Path) -> Result:
    """Run one turn of a contestant in its environment; return the result, its last line."""
    words = [
        str(interpreter(module, side)), "-m", f"bench.peers.{module}", f"--nbytes={nbytes}",
        f"--count={count}", f"--rate-hz={rate_hz}",
    ]  # fmt: skip
    output = run_to_end(words, LIMIT_S + count / rate_hz)
    result: Result = json.loads(output.strip().splitlines()[-1])
    return result


def run_to_end(words: list[str], limit_s: float) -> str:
    """Run a program and return its output; end its descendants with it, also after a timeout."""
    with subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as child:  # fmt: skip
        timeout_s = 0.0
        try:
            output, errors = child.communicate(timeout=limit_s)
            timeout_s = FAREWELL_S
        finally:
            end_group(child.pid, timeout_s)
    if child.returncode or not output.strip():
        last = (errors.strip().splitlines() or ["no error message"])[-1]
        raise subprocess.SubprocessError(f"ended with {child.returncode}: {last}")
    return output


def end_group(group: int, timeout_s: float) -> None:
    """Wait until the processes of a group have ended; after the timeout, kill the others.

    Python's resource tracker outlives its parent for a moment, to remove semaphores.
    """
    deadline = time.monotonic() + timeout_s
    with suppress(ProcessLookupError):
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(0.02)
        os.killpg(group, signal.SIGKILL)


def interpreter(module: str, side: Path) -> Path:
    """Return the Python interpreter of a contestant."""
    ours = {c.module for c in CONTESTANTS if c.ours}
    return Path(sys.executable) if module in ours else side / "bin" / "python"


def is_installed(contestant: Contestant, side: Path) -> bool:
    """Whether a contestant's library can be imported in its environment."""
    if contestant.ours:
        return True
    python = interpreter(contestant.module, side)
    words = [str(python), "-c", f"import {contestant.needs}"]
    return python.exists() and subprocess.run(words, capture_output=True).returncode == 0


def make_environment(side: Path, console: Console) -> None:
    """Make a virtual environment with the peers' libraries, unless it exists."""
    if (side / ".installed").exists():
        return
    with console.status(f"{side}: installing {', '.join(REQUIREMENTS)} (about 0.5 GB)"):
        subprocess.run([sys.executable, "-m", "venv", str(side)], check=True)
        pip = [str(side / "bin" / "python"), "-m", "pip", "install", "--quiet"]
        done = subprocess.run([*pip, *REQUIREMENTS], capture_output=True, text=True)
    if done.returncode:
        raise click.ClickException(f"{side}: not installed: {done.stderr.strip()[-300:]}")
    (side / ".installed").touch()


if __name__ == "__main__":
    main()
