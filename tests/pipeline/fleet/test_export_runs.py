"""Exported pods run in containers: probes and limits do what the manifests say.

Needs podman and the image of `pipeline/fleet/export/Containerfile`.
"""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.fleet import secure
from pipeline.fleet.export.bundle import IMAGE, READY, Bundle, most_mb
from pipeline.fleet.export.kubernetes import manifests
from pipeline.fleet.provisioning import issue_for
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from tests.sample_graphs import until

GRAPHS = Path(__file__).resolve().parents[3] / "graphs"
LIMIT_S = 60
STALE_S = 30.0  # as in the probe's command
LIMIT_FILES = "/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"

pytestmark = pytest.mark.slow


def podman(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ["podman", *words], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )


@pytest.fixture(autouse=True)
def image() -> None:
    if not shutil.which("podman") or podman("image", "exists", IMAGE).returncode:
        pytest.skip(f"needs podman and the image {IMAGE}")


@contextmanager
def played(documents: Sequence[Mapping[str, Any]], folder: Path) -> Iterator[str]:
    """Run a deployment and what it mounts; yield the name of its container."""
    file = folder / "pod.yaml"
    with file.open("w") as stream:
        YAML().dump_all(documents, stream)
    name = next(d["metadata"]["name"] for d in documents if d["kind"] == "Deployment")
    try:
        done = podman("kube", "play", "--network", "none", str(file))
        assert done.returncode == 0, done.stderr
        yield f"{name}-pod-0-fovea"
    finally:
        podman("kube", "down", str(file))


def is_alive(container: str) -> bool:
    """Run the liveness probe once, as its timer does where systemd runs."""
    return podman("healthcheck", "run", container).returncode == 0


def is_ready(container: str) -> bool:
    return podman("exec", container, *READY).returncode == 0


def inspected(container: str, what: str) -> str:
    return podman("inspect", container, "--format", f"{{{{.State.{what}}}}}").stdout.strip()


def limit_mb(container: str) -> float:
    found = (podman("exec", container, "cat", file) for file in LIMIT_FILES)
    return next(int(done.stdout) for done in found if done.returncode == 0) / (1 << 20)


def test_a_frozen_supervisor_is_found_after_half_a_minute_and_ended(tmp_path: Path) -> None:
    path = GRAPHS / "learned.yaml"
    plan, bundle = load(path), Bundle(path, tmp_path, "alice")
    _, documents = manifests(plan, bundle)
    with played(documents, tmp_path) as container:
        until(lambda: is_ready(container), LIMIT_S)  # a probe too early would restart it
        assert is_alive(container)
        assert limit_mb(container) == pytest.approx(most_mb(plan, bundle, ""), abs=1)

        frozen = inspected(container, "Pid")
        os.kill(int(frozen), signal.SIGSTOP)
        assert is_alive(container)
        time.sleep(STALE_S + 2.0)
        assert [is_alive(container) for _ in range(3)] == [False] * 3
        # podman 4 ends it, and starts it again unless its pod was ended meanwhile
        until(lambda: inspected(container, "Pid") != frozen, LIMIT_S)


def test_an_agent_is_alive_and_ready_before_anything_is_deployed(tmp_path: Path) -> None:
    path = GRAPHS / "multi_host.yaml"
    plan, credentials = load(path), tmp_path / "credentials"
    secure.create(credentials)
    list(issue_for(credentials, {label: label for label in plan.hosts}, [plan], ["alice"]))
    bundle = Bundle(path, credentials, "alice")
    with played([agent_of(plan, bundle, "sensor")], tmp_path) as container:
        until(lambda: is_ready(container), LIMIT_S)
        assert is_alive(container)
        assert limit_mb(container) == pytest.approx(most_mb(plan, bundle, "sensor"), abs=1)


def agent_of(plan: Plan, bundle: Bundle, label: str) -> dict[str, Any]:
    """Return the deployment of a host's agent; podman has no projected volumes."""
    _, documents = manifests(plan, bundle)
    found = next(d for d in documents if d["metadata"]["name"] == f"fovea-{label}")
    for volume in found["spec"]["template"]["spec"]["volumes"]:
        if volume.pop("projected", None):
            volume["hostPath"] = {"path": str(bundle.host_folder(label))}
    return found
