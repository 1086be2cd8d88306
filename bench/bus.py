"""What a picture costs from process to process, by fovea's bus and by its peers.

`python -m bench.bus [--json FILE] [--count N] [--rate-hz R] [--sizes N,N] [--peers] [--side-env F]`

Every contestant is a script of `bench.peers` and is measured by `bench.peers.ruler`. They take
turns, round by round and in a shuffled order, so that a noisy machine is noisy for all of them.
The peers' libraries live in an environment of their own, which `--peers` makes where it is absent.
"""

import json
import random
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from bench.machine import facts
from bench.peers.ruler import COLUMNS

ROOT = Path(__file__).resolve().parent.parent
SIZES = (65_536, 2_341_920, 9_367_680, 18_735_360)  # 2040x1148, 4080x2296, the same in 16 bit
REQUIREMENTS = ("iceoryx2==0.10.*", "ezmsg==3.9.*", "dora-rs==1.1.*", "dora-rs-cli==1.1.*", "numpy")
LIMIT_S = 120.0  # of one turn, beyond what its messages take

Result = dict[str, Any]  # what a contestant prints: see bench.peers.ruler.collect


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """A script and the environment it runs in."""

    module: str
    label: str
    ours: bool = False  # runs where fovea is installed, not in the peers' environment
    needs: str = ""  # module that must be importable there


CONTESTANTS = (
    Contestant(module="bare", label="floor: bare mapping and fifo", ours=True),
    Contestant(module="fovea_bus", label="fovea", ours=True),
    Contestant(module="zenoh_bytes", label="zenoh, bytes", ours=True),
    Contestant(module="iceoryx2_slices", label="iceoryx2", needs="iceoryx2"),
    Contestant(module="ezmsg_units", label="ezmsg", needs="ezmsg.core"),
    Contestant(module="dora_nodes", label="dora, tuned", needs="dora"),
)


@click.command()
@click.option("--json", "path", type=click.Path(path_type=Path), help="Write figures and facts.")
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
    """Measure what a picture costs from process to process."""
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
    console.print(table(figures, lengths))
    for sentence in failures:
        console.print(f"[red]{sentence}[/red]")
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({
            "bench": "bus", **facts(), "seed": seed, "rounds": rounds, "count_per_round": each,
            "rate_hz": rate_hz, "figures": figures, "failures": failures,
        }, indent=1))  # fmt: skip


def read_sizes(words: str) -> list[int]:
    """Bytes of each size; raises `click.BadParameter` for what is none.

    >>> read_sizes("64, 128")
    [64, 128]
    """
    try:
        sizes = [int(word) for word in words.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"--sizes: expected whole numbers, got {words!r}") from error
    if min(sizes) < 128:
        raise click.BadParameter(f"--sizes: must be at least 128 bytes, got {min(sizes)}")
    return sizes


def schedule(modules: list[str], sizes: list[int], rounds: int, seed: int) -> list[tuple[str, int]]:
    """Turns (contestant, bytes): in each round and size every contestant once, in any order."""
    rng = random.Random(seed)
    turns = []
    for _ in range(rounds):
        for nbytes in sizes:
            turns += [(module, nbytes) for module in rng.sample(modules, len(modules))]
    return turns


def take_turns(
    turns: list[tuple[str, int]], count: int, rate_hz: float, side: Path, console: Console
) -> tuple[list[Result], list[str]]:
    """Run every turn; results, and a sentence for each that failed."""
    results, failures = [], []
    columns = (SpinnerColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))  # fmt: skip # noqa: E501
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
    """One turn of one contestant in its environment; its last line is the result."""
    words = [
        str(interpreter(module, side)), "-m", f"bench.peers.{module}", f"--nbytes={nbytes}",
        f"--count={count}", f"--rate-hz={rate_hz}",
    ]  # fmt: skip
    limit_s = LIMIT_S + count / rate_hz
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=limit_s)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise subprocess.SubprocessError(f"ended with {done.returncode}: {last}")
    result: Result = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def interpreter(module: str, side: Path) -> Path:
    """The Python a contestant runs in."""
    ours = {c.module for c in CONTESTANTS if c.ours}
    return Path(sys.executable) if module in ours else side / "bin" / "python"


def is_installed(contestant: Contestant, side: Path) -> bool:
    """Whether its library can be imported in its environment."""
    if contestant.ours:
        return True
    python = interpreter(contestant.module, side)
    words = [str(python), "-c", f"import {contestant.needs}"]
    return python.exists() and subprocess.run(words, capture_output=True).returncode == 0


def make_environment(side: Path, console: Console) -> None:
    """A virtual environment with the peers' libraries; made once."""
    if (side / ".installed").exists():
        return
    with console.status(f"{side}: installing {', '.join(REQUIREMENTS)} (about 0.5 GB)"):
        subprocess.run([sys.executable, "-m", "venv", str(side)], check=True)
        pip = [str(side / "bin" / "python"), "-m", "pip", "install", "--quiet"]
        subprocess.run([*pip, *REQUIREMENTS], check=True, stderr=subprocess.DEVNULL)
    (side / ".installed").touch()


def summarise(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Figures per contestant and size over all rounds, in milliseconds.

    `beyond_ms`: borrowing memory and handing over, without writing and reading; `p50_rounds` are
    the medians of the single rounds, least and most.
    """
    grouped: dict[tuple[str, int], list[Result]] = {}
    for result in results:
        grouped.setdefault((result["contestant"], result["nbytes"]), []).append(result)
    return [figures_of(group) for _, group in sorted(grouped.items(), key=lambda g: g[0][::-1])]


def figures_of(group: list[Result]) -> dict[str, Any]:
    """One row: a contestant at one size."""
    rounds = [beyond_ms(r) for r in group if r["samples"]]
    every = np.concatenate([*rounds, np.zeros(0)])
    sent = sum(r["sent"] for r in group)
    medians = [float(np.median(r)) for r in rounds]
    samples = np.concatenate([rows(r) for r in group])
    return {
        "contestant": group[0]["contestant"],
        "version": group[0]["version"],
        "nbytes": group[0]["nbytes"],
        "sent": sent,
        "lost": sent - len(every),
        "torn": sum(r["torn"] for r in group),
        "beyond_ms": quantiles(every),
        "p50_rounds": [round(v, 4) for v in (min(medians, default=0), max(medians, default=0))],
        "write_ms": quantiles((samples[:, 3] - samples[:, 2]) / 1e6),
        "read_ms": quantiles((samples[:, 5] - samples[:, 4]) / 1e6),
        "bare_write_ms": quantiles(np.array([v for r in group for v in r["bare_write_ns"]]) / 1e6),
        "bare_read_ms": quantiles(np.array([v for r in group for v in r["bare_read_ns"]]) / 1e6),
        "sender_cpu_ms": round(sum(r["sender_cpu_ns"] for r in group) / sent / 1e6, 4),
        "receiver_cpu_ms": round(sum(r["receiver_cpu_ns"] for r in group) / sent / 1e6, 4),
    }


def rows(result: Result) -> NDArray[np.int64]:
    """(n, 6) clocks in nanoseconds, columns as in `ruler.COLUMNS`."""
    return np.array(result["samples"], np.int64).reshape(-1, len(COLUMNS))


def beyond_ms(result: Result) -> NDArray[np.float64]:
    """(n,) time a message took beyond writing and reading it.

    >>> clocks = [0, 1_000_000, 1_250_000, 4_000_000, 4_500_000, 9_000_000]
    >>> beyond_ms({"samples": [clocks]}).tolist()
    [0.75]
    """
    _, asked, writing, written, received, _ = rows(result).T
    beyond: NDArray[np.float64] = ((writing - asked) + (received - written)) / 1e6
    return beyond


def quantiles(values_ms: NDArray[np.float64]) -> dict[str, float]:
    """Least, median and 99th percentile; empty without values."""
    if not len(values_ms):
        return {}
    p50, p99 = np.percentile(values_ms, [50, 99])
    return {"min": round(float(values_ms.min()), 4), "p50": round(float(p50), 4), "p99": round(float(p99), 4)}  # fmt: skip # noqa: E501


def table(figures: list[dict[str, Any]], sizes: list[int]) -> Table:
    """Milliseconds beyond writing and reading, with the ratio of medians to fovea's."""
    labels = {c.module: c.label for c in CONTESTANTS}
    shown = Table(
        "bytes", "contestant", "p50", "p99", "min", "p50 by round", "x fovea", "write", "read",
        "cpu send", "cpu recv", "lost",
        title="ms per message beyond writing and reading it",
    )  # fmt: skip
    for nbytes in sizes:
        here = [row for row in figures if row["nbytes"] == nbytes]
        ours = ratio_base(here)
        for row in sorted(here, key=lambda r: r["beyond_ms"].get("p50", np.inf)):
            shown.add_row(*cells(row, labels, ours))
        shown.add_section()
    return shown


def ratio_base(here: list[dict[str, Any]]) -> float:
    """fovea's median among the rows of one size, NaN without it."""
    found = [
        r["beyond_ms"]["p50"] for r in here if r["contestant"] == "fovea_bus" and r["beyond_ms"]
    ]
    return float(found[0]) if found else float("nan")


def cells(row: Mapping[str, Any], labels: Mapping[str, str], ours_ms: float) -> list[str]:
    """One line of the table."""
    beyond = row["beyond_ms"] or dict.fromkeys(("min", "p50", "p99"), float("nan"))
    least, most = row["p50_rounds"]
    return [
        str(row["nbytes"]), f"{labels.get(row['contestant'], row['contestant'])}",
        f"{beyond['p50']:.2f}", f"{beyond['p99']:.2f}", f"{beyond['min']:.2f}",
        f"{least:.2f}–{most:.2f}", f"{beyond['p50'] / ours_ms:.2f}",
        f"{row['write_ms'].get('p50', float('nan')):.2f}",
        f"{row['read_ms'].get('p50', float('nan')):.2f}",
        f"{row['sender_cpu_ms']:.2f}", f"{row['receiver_cpu_ms']:.2f}", str(row["lost"]),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
