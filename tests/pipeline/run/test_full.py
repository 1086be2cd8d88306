"""Full disks and full shared memory are reported in one sentence and cause no other failure."""

import secrets
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pipeline.run.memory_folder import MEMORY
from tests.pipeline.run.namespaces import with_small_mounts
from tests.sample_graphs import LOOP, together

WRITER = """
import os, sys
from pathlib import Path
from pipeline.node.logfile import log_to
log_to(Path(sys.argv[1]), fresh=True, most_bytes=1000)
for i in range(100):
    print(f"line {i} of many")
os.write(2, b"a library's own words\\n")
"""
IN_FULL_FOLDER = """
import logging, signal, sys
from pathlib import Path
from pipeline.client.find import find
from pipeline.errors import RunError
from pipeline.graph.loader import load
from tests.sample_graphs import (
    assert_accounts_add_up, go, handled, send_signal, wait_for, wait_for_progress,
)

def during(supervisor):
    wait_for(supervisor, lambda: handled(supervisor, "steer") > 3)
    with (Path(sys.argv[2]) / "filler").open("wb", buffering=0) as file:
        try:
            while file.write(bytes(64)):
                pass
        except OSError:
            pass
    for act in (
        lambda: find(plan.name).configure("work", {"every": 2}),
        lambda: find(plan.name).command("work", "break_down", {}),
    ):
        try:
            act()
        except RunError as error:
            print(error)
    wait_for(supervisor, lambda: supervisor.pid("pair"))
    send_signal(supervisor, "pair", signal.SIGKILL)
    wait_for(supervisor, lambda: supervisor.restarts == {"work": 1, "pair": 1})
    wait_for_progress(supervisor, "steer")
    supervisor.finish()

logging.basicConfig()
plan = load(Path(sys.argv[1]))
report = go(plan, 0, during)
assert_accounts_add_up(report)
print("failure:", report["failure"])
"""


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    text = together(LOOP, "ticker", "steer")
    path.write_text(f"name: full-{secrets.token_hex(3)}\n{text}")
    return path


@pytest.mark.parametrize("name", ["work.log", "run.out"])
def test_a_log_is_bounded_and_holds_what_libraries_print(tmp_path: Path, name: str) -> None:
    log = tmp_path / name

    subprocess.run([sys.executable, "-c", WRITER, str(log)], check=True)

    sizes = [log.stat().st_size, (tmp_path / f"{name}.old").stat().st_size]
    assert max(sizes) < 1100
    assert log.read_text().endswith("line 99 of many\na library's own words\n")


@pytest.mark.lengthy
def test_on_a_full_disk_nodes_break_are_restarted_and_lose_only_log_lines(
    graph: Path,
) -> None:
    small = Path(tempfile.mkdtemp())  # short: the paths of sockets are bounded

    done = with_small_mounts(
        {small: "300k"}, "-c", IN_FULL_FOLDER, str(graph), str(small), TMPDIR=str(small)
    )

    assert "work: cannot be kept: [Errno 28] No space left on device" in done.stdout, done.stderr
    assert "told to break" in done.stdout
    assert "run.json: cannot be written: No space left on device" in done.stderr
    assert done.stdout.endswith("failure: \n")


@pytest.mark.lengthy
def test_in_full_shared_memory_a_graph_that_runs_goes_on(graph: Path) -> None:
    done = with_small_mounts({MEMORY: "3m"}, "-c", IN_FULL_FOLDER, str(graph), str(MEMORY))

    assert "told to break" in done.stdout, done.stderr
    assert done.stdout.endswith("failure: \n")


def test_a_graph_that_does_not_fit_into_shared_memory_is_refused_in_one_sentence(
    graph: Path,
) -> None:
    words = ("-m", "pipeline.cli", "run", str(graph), "--set", "ticker.side_px=1000")
    done = with_small_mounts({MEMORY: "4m"}, *words)

    assert done.returncode == 2
    assert "no room for a frame pool of" in done.stderr
    assert "Traceback" not in done.stderr
