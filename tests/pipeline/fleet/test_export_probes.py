"""The probes of a manifest, word for word, against the process that its command starts."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.fleet.export.bundle import GRAPH, HEARTBEAT, Bundle
from pipeline.fleet.export.kubernetes import manifests
from pipeline.graph.loader import load
from pipeline.run.rundir import running
from tests.sample_graphs import CHAIN, plan_of, together, until

FOVEA = (sys.executable, "-m", "pipeline.entry")


def container_of(graph: Path) -> dict[str, Any]:
    """Return the only container of a graph of one host."""
    _, documents = manifests(load(graph), Bundle(graph, graph.parent, "alice"))
    (pod,) = (d["spec"]["template"]["spec"] for d in documents if d["kind"] == "Deployment")
    (container,) = pod["containers"]
    return dict(container)


@contextmanager
def started(container: dict[str, Any], places: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a container's command, with other places for its files."""
    program, *words = (places.get(word, word) for word in container["command"])
    assert program == "fovea"
    process = subprocess.Popen([*FOVEA, *words], stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        process.wait(60)


def test_probes_follow_what_becomes_of_a_running_graph(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(CHAIN, "ticker", "count"))
    (graph,) = tmp_path.glob("*.yaml")
    container, file = container_of(graph), tmp_path / "heartbeat"
    places = {GRAPH: str(graph), HEARTBEAT: str(file)}

    def passes(probe: str) -> bool:
        words = [places.get(word, word) for word in container[probe]["exec"]["command"]]
        return subprocess.run(words, check=False, capture_output=True).returncode == 0

    assert not any(map(passes, ("startupProbe", "livenessProbe", "readinessProbe")))
    with started(container, places) as process:
        until(lambda: passes("readinessProbe"))
        assert passes("startupProbe")
        assert passes("livenessProbe")

        os.kill(running()[plan.name]["pids"]["glance"], signal.SIGKILL)
        until(lambda: not passes("readinessProbe"))
        assert passes("livenessProbe")  # it is restarted without the engine
        until(lambda: passes("readinessProbe"))

        process.send_signal(signal.SIGSTOP)
        long_ago_s = time.time() - 40  # as if it had been stopped since
        until(lambda: is_stopped(process.pid))
        os.utime(file, (long_ago_s, long_ago_s))
        assert not passes("livenessProbe")
        process.send_signal(signal.SIGCONT)
        until(lambda: passes("livenessProbe"))
    assert not any(map(passes, ("startupProbe", "livenessProbe", "readinessProbe")))


def is_stopped(pid: int) -> bool:
    """Return whether a process stands still by a signal."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
