"""Exported hosts have probes that tell when one hangs, and limits that follow from the graph."""

import os
import subprocess
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from pipeline.cli.fleet import export_command
from pipeline.fleet.export.bundle import (
    ALIVE,
    HEARTBEAT,
    OWN_MB,
    READY,
    SPARE_MB,
    Bundle,
    memory_mb,
    most_mb,
)
from pipeline.fleet.export.compose import compose
from pipeline.fleet.export.kubernetes import k8s
from pipeline.graph.plan import slots
from tests.pipeline.fleet.agents import TRIO, plan_of

GRAPHS = Path(__file__).resolve().parents[3] / "graphs"


@pytest.mark.parametrize(
    ("text", "old_s", "alive", "ready"),
    [
        ("running\n", 0, True, True),
        ("starting\n", 20, True, False),
        ("running\n", 40, False, True),
        ("", 0, True, False),
        (None, 0, False, False),
    ],
)
def test_probes_tell_a_heartbeat_that_is_old_or_says_that_something_starts(
    text: str | None, old_s: float, alive: bool, ready: bool, tmp_path: Path
) -> None:
    file = tmp_path / "heartbeat"
    if text is not None:
        file.write_text(text)
        os.utime(file, (time.time() - old_s,) * 2)

    for probe, expected in ((ALIVE, alive), (READY, ready)):
        # by its name: podman gives the words, joined, to a shell, and `HEARTBEAT` has no blank
        words = [file.name if word == HEARTBEAT else word for word in probe]
        done = subprocess.run(words, cwd=tmp_path, check=False)
        assert (done.returncode == 0) is expected
        done = subprocess.run(" ".join(words), cwd=tmp_path, shell=True, check=False)
        assert (done.returncode == 0) is expected


def test_every_pod_of_a_host_is_probed_where_its_command_writes(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    bundle = Bundle(tmp_path / "graph.yaml", tmp_path, "alice")
    for document in YAML(typ="safe").load_all(k8s(plan, bundle)):
        if document["kind"] != "Deployment":
            continue
        (container,) = document["spec"]["template"]["spec"]["containers"]
        written = container["command"][container["command"].index("--heartbeat") + 1]
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            assert written in container[probe]["exec"]["command"]
    services = YAML(typ="safe").load(compose(plan, bundle))["services"]
    assert ["healthcheck" in services[name] for name in (*plan.hosts, "deploy")] == [
        True, True, True, False,
    ]  # fmt: skip


def test_memory_is_limited_to_what_nodes_pools_and_the_agent_may_take(tmp_path: Path) -> None:
    graph = TRIO.replace("    host: viewer\n", "    host: viewer\n    memory_mb: 300\n")
    plan = plan_of(tmp_path, graph)
    bundle = Bundle(tmp_path / "graph.yaml", tmp_path, "alice", {"capture.context": 100_000_000})

    assert memory_mb(plan, bundle, "viewer") == SPARE_MB  # nothing reads what it sends
    assert most_mb(plan, bundle, "viewer") == OWN_MB + 300 + SPARE_MB
    context, roi = 100, 64 * slots(plan.readers("capture", "roi"))  # one is known
    assert memory_mb(plan, bundle, "sensor") == SPARE_MB + 2 * (context + roi)
    assert most_mb(plan, bundle, "sensor") == OWN_MB + 1024 + memory_mb(plan, bundle, "sensor")


def test_pools_take_what_the_settings_tell_where_they_do(tmp_path: Path) -> None:
    words = ["k8s", str(GRAPHS / "learned.yaml"), f"--credentials={tmp_path}"]
    text = CliRunner().invoke(export_command, words, catch_exceptions=False).output

    _, deployment = YAML(typ="safe").load_all(text)
    pod = deployment["spec"]["template"]["spec"]
    (shared,) = (v["emptyDir"]["sizeLimit"] for v in pod["volumes"] if v["name"] == "shm")
    assert 64 < int(shared.removesuffix("Mi")) < 1000
