"""Attacks by another local user: `python -m bench.other_user --minutes 10 --json FILE`.

A graph is started repeatedly and its nodes are killed, so that it makes new files all the time.
Meanwhile another user runs the attacks of `bench.other_user_attempts`. Every picture is compared
byte by byte. Decoys (a folder and a file open to everybody) show that the attacks succeed where
permissions allow them. Needs root, to run as two users.
"""

import contextlib
import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress

from bench.leftovers import Traces, unbalanced
from bench.machine import facts
from bench.options import JSON, Bench
from bench.other_user_attempts import DECOY
from pipeline.errors import RunError
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.run.memory_folder import MEMORY
from pipeline.run.report import compose
from pipeline.run.supervisor import Supervisor

NOBODY = 65534
ROUND_S = 6.0  # one run of the graph
KILL_S = 2.0
GRAPH = """\
name: other_user-{token}
nodes:
  eye: {{operator: "bench.samples:Metronome", settings: {{rate_hz: 100, side_px: 256}}}}
  work: {{operator: "bench.samples:Forward", inputs: {{frame: eye}}}}
  check: {{operator: "bench.samples:Inspector", inputs: {{frame: work}}}}
"""


@click.command(cls=Bench)
@click.option("--minutes", default=10.0, show_default=True, type=click.FloatRange(0.05))
@JSON
def main(minutes: float, path: Path | None) -> None:
    """Run the attacks of another user."""
    with Progress(console=Console(stderr=True)) as progress:
        result = {
            "bench": "other_user",
            **facts(),
            "minutes": minutes,
            **measure(minutes, progress),
        }
    click.echo(json.dumps({k: v for k, v in result.items() if k not in ("libraries", "machine")}))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))
    if result["achieved"] or result["torn"] or result["crashes"] or result["left"]:
        raise click.ClickException("an attack of another user succeeded")


def measure(minutes: float, progress: Progress) -> dict[str, Any]:
    """Return what the other user tried and achieved, and how the graph ran meanwhile."""
    if os.geteuid() != 0:
        raise RunError("expected to run as root, which can become another user")
    found: dict[str, Any] = {"runs": 0, "pictures": 0, "torn": 0, "crashes": 0, "left": []}
    task = progress.add_task("attacks", total=minutes * 60)
    with _decoys(), _other_user(minutes * 60) as other_user:
        began_s = time.monotonic()
        while (elapsed_s := time.monotonic() - began_s) < minutes * 60:
            _one_life(found)
            progress.update(task, completed=elapsed_s)
        said = other_user.communicate()[0].splitlines()
    return {**found, **json.loads(said[-1])}


def _one_life(found: dict[str, Any]) -> None:
    """Run the graph once, kill nodes meanwhile, and add its figures to `found`."""
    path = Path(os.path.realpath(MEMORY)) / f"graph-{secrets.token_hex(4)}.yaml"
    path.write_text(GRAPH.format(token=secrets.token_hex(3)))
    try:
        plan: Plan = load(path)
    finally:
        path.unlink()
    victims, killed = ["work", "check", "eye"], 0
    with Supervisor(plan) as supervisor:
        supervisor.allow_restarts(1000)
        supervisor.start()
        traces, began_s = Traces.of(plan.name), time.monotonic()
        while (lived_s := time.monotonic() - began_s) < ROUND_S and not supervisor.failure:
            if lived_s > (killed + 1) * KILL_S and killed < 2 and supervisor.manager.all_going:
                os.kill(supervisor.pid(victims[(found["runs"] + killed) % 3]), 9)
                killed += 1
            supervisor.tick()
        supervisor.finish()
        supervisor.stop()
        report = compose(
            plan, supervisor.ledger, supervisor.reports.summaries, {}, duration_s=ROUND_S
        )
        restarts, failure = sum(supervisor.restarts.values()), supervisor.failure
    found["runs"] += 1
    found["pictures"] += report["edges"][-1]["delivered"]
    found["torn"] += report.get("torn", 0) + len(unbalanced(report["edges"]))
    found["crashes"] += max(0, restarts - killed) + bool(failure)
    found["left"] += traces.files() + traces.orphans()


@contextlib.contextmanager
def _other_user(seconds: float) -> Iterator["subprocess.Popen[str]"]:
    """Run the attacks in a process that first drops root's rights."""
    words = [str(NOBODY), str(os.geteuid()), str(seconds)]
    process = subprocess.Popen(
        [sys.executable, "-m", "bench.other_user_attempts", *words],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@contextlib.contextmanager
def _decoys() -> Iterator[None]:
    """Make a folder and a file that all users may enter, read and alter; remove them at exit."""
    folder = MEMORY / f"fovea-{DECOY}-{secrets.token_hex(4)}"
    folder.mkdir()
    folder.chmod(0o777)
    (folder / "open").write_bytes(bytes(9000))
    (folder / "open").chmod(0o666)
    try:
        yield
    finally:
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()


if __name__ == "__main__":
    main()
