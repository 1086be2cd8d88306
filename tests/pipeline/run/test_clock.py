"""No figure, limit or decision depends on the wall clock, which may jump."""

import ast
import os
import secrets
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.sample_graphs import LOOP, together

ROOT = Path(__file__).resolve().parents[3]
# ages of files, validity of certificates, times shown by `ps` and in recordings are by it
ASKED_FOR_FILES = {
    *("detached.py", "leftovers.py", "recorder.py", "secure.py", "warm_spare.py"),
    "tracing.py",  # collectors of spans want the time of day
}
UNDER_JUMPS = """
import signal, sys, time
from pathlib import Path
from pipeline.client.find import find
from pipeline.graph.loader import load
from tests.sample_graphs import (
    assert_accounts_add_up, go, handled, send_signal, wait_for, wait_for_progress,
)

HOUR_MS = 3_600_000  # every jump is longer

def during(supervisor):
    wait_for(supervisor, lambda: handled(supervisor, "steer") > 10)
    seen = {time.time() // 43200}
    end = time.monotonic() + 60  # it jumps four times a second
    while len(seen) == 1 and time.monotonic() < end:
        seen.add(time.time() // 43200)
    assert len(seen) == 2, "the clock does not jump"
    print("jumps")
    send_signal(supervisor, "work", signal.SIGKILL)
    wait_for(supervisor, lambda: supervisor.restarts == {"work": 1} and supervisor.pid("work"))
    wait_for_progress(supervisor, "work")
    print("well:", all(h and not h.problem for h in find(plan.name).health().values()))
    supervisor.finish()

plan = load(Path(sys.argv[1]))
report = go(plan, 0, during)
assert_accounts_add_up(report)
assert report["restarts"] == {"work": 1}, report["restarts"]
assert report["failure"] == "", report["failure"]
assert report["loop"]["latency_ms"]["p99"] < HOUR_MS, report["loop"]
assert report["edges"][0]["age_ms"]["p99"] < HOUR_MS, report["edges"][0]
print("done")
"""


@pytest.fixture
def jumping(short_path: Path) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here")
    library = short_path / "jumping.so"  # LD_PRELOAD allows no blank in a path
    source = Path(__file__).with_name("jumping_clock.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library


@pytest.mark.lengthy
def test_jumps_of_the_wall_clock_do_not_affect_a_graph(jumping: Path, tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: clock-{secrets.token_hex(3)}\n{together(LOOP, 'pair', 'steer')}")

    done = subprocess.run(
        [sys.executable, "-c", UNDER_JUMPS, str(path)], capture_output=True, text=True,
        timeout=180, check=False, cwd=ROOT, env={**os.environ, "LD_PRELOAD": str(jumping)},
    )  # fmt: skip

    assert done.stdout.splitlines() == ["jumps", "well: True", "done"], done.stderr


def test_nothing_that_runs_reads_the_wall_clock() -> None:
    asked = set()
    for path in sorted((ROOT / "pipeline").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            words = ast.unparse(node) if isinstance(node, ast.Attribute) else ""
            if words in ("time.time", "time.time_ns", "datetime.now", "datetime.datetime.now"):
                asked.add(path.name)

    assert asked == ASKED_FOR_FILES
