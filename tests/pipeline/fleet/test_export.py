"""What is printed for other engines has every box, its memory and its papers; it is well formed."""

import configparser
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.errors import RunError, SettingsError
from pipeline.fleet import secure
from pipeline.fleet.agent_file import read
from pipeline.fleet.deploy import read_hosts
from pipeline.fleet.draft import check_addressed, issue_for
from pipeline.fleet.export import compose, k8s, memory_mb, systemd
from pipeline.fleet.unit import agent_unit
from tests.pipeline.fleet.boxes import ALLOWED, TRIO, plan_of

ALONE = TRIO.replace("hosts: [sensor, compute, viewer]\n", "")
for _label in ("sensor", "compute", "viewer"):
    ALONE = ALONE.replace(f"    host: {_label}\n", "")


def test_compose_has_a_service_per_box_with_shared_memory_of_its_own(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)

    services: dict[str, Any] = YAML(typ="safe").load(compose(plan, "graph.yaml"))["services"]

    assert set(services) == {"sensor", "compute", "viewer", "deploy"}
    assert services["sensor"]["shm_size"] == f"{memory_mb(plan, 'sensor')}mb"
    assert "sensor=sensor:7447" in " ".join(services["deploy"]["command"])


def test_k8s_has_a_pod_per_box_and_never_two_owners_of_a_sensor(tmp_path: Path) -> None:
    documents = list(YAML(typ="safe").load_all(k8s(plan_of(tmp_path), "graph.yaml")))

    kinds = [document["kind"] for document in documents]
    assert kinds == ["Deployment", "Service"] * 3 + ["Job"]
    assert {d["spec"]["strategy"]["type"] for d in documents if d["kind"] == "Deployment"} == {
        "Recreate"
    }


def test_systemd_units_are_units(tmp_path: Path) -> None:
    texts = systemd(plan_of(tmp_path), "graph.yaml").split("\n# ")

    assert len(texts) == 4
    for text in [*texts, agent_unit(tmp_path / "agent.yaml", tmp_path / "state")]:
        unit = configparser.ConfigParser(strict=True, interpolation=None)
        unit.optionxform = str  # type: ignore[assignment,method-assign]
        unit.read_string(text[text.index("[Unit]") :])
        assert unit["Service"]["ExecStart"]
        assert unit["Install"]["WantedBy"] == "multi-user.target"


def test_a_graph_without_hosts_is_one_service(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, ALONE)

    assert list(YAML(typ="safe").load(compose(plan, "g.yaml"))["services"]) == ["trio"]
    assert "fovea run g.yaml" in systemd(plan, "g.yaml")
    assert YAML(typ="safe").load(k8s(plan, "g.yaml"))["kind"] == "Deployment"


def test_papers_and_agent_files_allow_what_the_graph_has_on_that_box_and_no_more(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "authority"
    secure.create(folder)

    addresses = {"sensor": "10.0.0.1", "compute": "10.0.0.2:7000", "viewer": "10.0.0.3"}
    lines = list(issue_for(folder, addresses, [plan_of(tmp_path)], ["alice"]))

    assert len(lines) == 4
    box = read(folder / "box.compute" / "agent.yaml")
    assert box.endpoint == "tls/10.0.0.2:7000"
    assert set(box.file.operators) == {"tests.toys:Pass", "tests.toys:Pair", "tests.toys:Steer"}
    assert set(box.file.operators) < set(ALLOWED)
    assert box.holders == ("person.alice", "box.sensor", "box.viewer")
    assert box.papers is not None
    assert sorted(p.name for p in (folder / "box.compute" / "nodes").iterdir()) == [
        "node.trio.pair", "node.trio.steer", "node.trio.work",
    ]  # fmt: skip
    assert (folder / "ca.key").stat().st_mode & 0o077 == 0
    assert not list((folder / "box.compute").rglob("ca.key"))

    hosts = read_hosts((), folder / "person.alice", ["compute", "viewer"])
    assert hosts.points == {"compute": "tls/10.0.0.2:7000", "viewer": "tls/10.0.0.3:7447"}
    with pytest.raises(SettingsError, match="expected desk=ADDRESS"):
        read_hosts((), folder / "person.alice", ["desk"])


def test_a_box_without_an_address_is_told_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="expected --box viewer=ADDRESS, got none"):
        check_addressed(tmp_path, {"sensor": "a", "compute": "b"}, [plan_of(tmp_path)])


def test_an_authority_is_made_once_and_papers_are_their_holders(tmp_path: Path) -> None:
    secure.create(tmp_path / "ca")
    with pytest.raises(RunError, match="without an authority"):
        secure.create(tmp_path / "ca")

    papers = secure.issue(tmp_path / "own", tmp_path / "ca", "box.sensor")
    assert papers.holder == "box.sensor"
    papers.key.chmod(0o644)
    with pytest.raises(SettingsError, match="only its owner can read"):
        secure.Papers.of(papers.folder)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "label: sensor\naddress: 10.0.0.1\n",
            r":2: address: 10\.0\.0\.1: a network address needs",
        ),
        ("label: ../x\n", r"label: expected a label of letters"),
        ("label: a\nopertors: {}\n", r"no such setting, did you mean 'operators'"),
        ("label: a\noperators: {a:B: yes}\n", r"operators"),
        ("label: a\npapers: .\naddress: h\nports: [9, 1]\n", r"ports: expected first and last"),
    ],
)
def test_a_wrong_agents_file_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "agent.yaml"
    path.write_text(text)

    with pytest.raises(SettingsError, match=said):
        read(path)
