"""What `fovea export` prints is accepted by the engine that it is for."""

import shutil
import subprocess
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.fleet import secure
from pipeline.fleet.export.bundle import Bundle
from pipeline.fleet.export.compose import compose
from pipeline.fleet.export.kubernetes import k8s
from pipeline.fleet.export.systemd import agent_unit, systemd
from pipeline.fleet.provisioning import issue_for
from pipeline.graph.loader import load
from tests.pipeline.fleet.agents import TRIO, plan_of

LIMIT_S = 60
ALONE = TRIO.replace("hosts: [sensor, compute, viewer]\n", "")
for _label in ("sensor", "compute", "viewer"):
    ALONE = ALONE.replace(f"    host: {_label}\n", "")


@pytest.fixture(params=["several hosts", "one host"])
def bundle(tmp_path: Path, request: pytest.FixtureRequest) -> Bundle:
    """Make a graph, and credentials if it has several hosts."""
    several = request.param == "several hosts"
    plan = plan_of(tmp_path, TRIO if several else ALONE)
    credentials = tmp_path / "credentials"
    if several:
        secure.create(credentials)
        list(issue_for(credentials, {label: label for label in plan.hosts}, [plan], ["alice"]))
    return Bundle(tmp_path / "graph.yaml", credentials, "alice")


def accepted(*words: str | Path) -> None:
    """Run a command; assert that it has no complaint."""
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr + done.stdout


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="needs systemd-analyze")
def test_systemd_verifies_every_unit(bundle: Bundle, tmp_path: Path) -> None:
    verify(systemd(load(bundle.graph), bundle), tmp_path / "units")


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="needs systemd-analyze")
def test_systemd_verifies_the_unit_of_an_agent_in_a_folder_of_any_name(tmp_path: Path) -> None:
    folder = tmp_path / "50% of 'all' $HOME"
    folder.mkdir()

    unit = agent_unit(folder / "agent.yaml", folder / "what runs", told=True)

    verify(unit, tmp_path / "units")


def verify(text: str, folder: Path) -> None:
    """Assert that systemd has no complaint about any of the units."""
    parts = text.split("[Unit]")[1:]
    folder.mkdir()
    for number, part in enumerate(parts):
        # the users and folders of other hosts are not here; their lines are not in question
        lines = [line for line in f"[Unit]{part}".splitlines() if not line.startswith("User=")]
        unit = folder / f"fovea-{number}.service"
        unit.write_text("\n".join(lines) + "\n")

        done = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(unit)],
            capture_output=True, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
        # it also tells of this machine's own units
        assert [line for line in done.stderr.splitlines() if unit.name in line] == []
    assert parts


def test_a_wrong_unit_would_be_told(tmp_path: Path) -> None:
    if not shutil.which("systemd-analyze"):
        pytest.skip("needs systemd-analyze")
    unit = tmp_path / "wrong.service"
    unit.write_text("[Service]\nExecStart=relative/path\nRestartSec=soon\n")

    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)],
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip

    assert "wrong.service" in done.stderr


@pytest.mark.skipif(not shutil.which("docker-compose"), reason="needs docker-compose")
def test_compose_reads_the_file(bundle: Bundle, tmp_path: Path) -> None:
    file = tmp_path / "compose.yaml"
    file.write_text(compose(load(bundle.graph), bundle))

    accepted("docker-compose", "--file", file, "config", "--quiet")


def test_kubernetes_schemas_accept_every_document(bundle: Bundle) -> None:
    kubernetes_validate = pytest.importorskip("kubernetes_validate", reason="needs the dev extra")
    documents = list(YAML(typ="safe").load_all(k8s(load(bundle.graph), bundle)))

    for document in documents:
        kubernetes_validate.validate(document, kubernetes_validate.latest_version(), strict=True)
    wrong = documents[-1] | {"spec": {"template": 3}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, kubernetes_validate.latest_version(), strict=True)
