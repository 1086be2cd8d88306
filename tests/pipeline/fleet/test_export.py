"""Exports for other engines work: every file is where the engine reads it."""

import configparser
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from pipeline.cli.fleet import agent_command, export_command
from pipeline.errors import GraphError, RunError, SettingsError
from pipeline.fleet import secure
from pipeline.fleet.agent_file import read
from pipeline.fleet.deploy import default_user
from pipeline.fleet.export.bundle import AGENT, HEARTBEAT, Bundle, memory_mb
from pipeline.fleet.export.compose import compose
from pipeline.fleet.export.kubernetes import k8s
from pipeline.fleet.export.systemd import systemd
from pipeline.fleet.hosts import read_hosts
from pipeline.fleet.links import networks
from pipeline.fleet.placement import place, plan_for
from pipeline.fleet.provisioning import check_addressed, issue_for
from pipeline.fleet.secure import Credentials
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from tests.pipeline.fleet.agents import ALLOWED, TRIO, plan_of

ALONE = TRIO.replace("hosts: [sensor, compute, viewer]\n", "")
for _label in ("sensor", "compute", "viewer"):
    ALONE = ALONE.replace(f"    host: {_label}\n", "")


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    """Make credentials as `fovea secure init` does, and the graph that they are for."""
    plan = plan_of(tmp_path)
    credentials = tmp_path / "credentials"
    secure.create(credentials)
    for _line in issue_for(credentials, {label: label for label in plan.hosts}, [plan], ["alice"]):
        pass
    return Bundle(tmp_path / "graph.yaml", credentials, "alice")


def expect_agent(plan: Plan, label: str, folder: Path) -> None:
    """Assert that everything that the agent of a host reads is there and is its own."""
    own = read(folder / "agent.yaml")
    assert own.endpoint == f"tls/{label}:7447"
    assert own.credentials is not None
    part = plan_for(plan, label)
    points = {place(node): "tls/somewhere:7500" for node in plan.nodes}
    here = networks(part, points, points, own.credentials)
    assert set(here) == {n.process for n in plan.nodes if n.host == label}
    for process, network in here.items():
        identity = Credentials.of(Path(network.credentials)).identity
        assert identity == f"node.trio.{process}"


def expect_deploy(words: Sequence[str], root: Path) -> None:
    """Assert that everything that `fovea up` reads is where its options point."""
    at = [root / word.removeprefix("/") for word in words]
    assert words[:2] == ["fovea", "up"]
    assert load(at[2]).name == "trio"
    credentials = at[words.index("--credentials") + 1]
    assert Credentials.of(credentials).identity == "user.alice"
    hosts = read_hosts([words[words.index("--hosts") + 1]], credentials, ["sensor"])
    assert hosts.points == {n: f"tls/{n}:7447" for n in ("sensor", "compute", "viewer")}


def test_compose_mounts_credentials_and_graph_where_they_are_read(
    bundle: Bundle, tmp_path: Path
) -> None:
    plan = load(bundle.graph)
    services: dict[str, Any] = YAML(typ="safe").load(compose(plan, bundle))["services"]

    assert set(services) == {"sensor", "compute", "viewer", "deploy"}
    for name, service in services.items():
        root = tmp_path / "roots" / name
        for volume in service["volumes"]:
            source, target, *_ = volume.split(":")
            path = root / target.removeprefix("/")
            path.parent.mkdir(parents=True, exist_ok=True)
            if Path(source).is_absolute():
                path.symlink_to(source)
        assert service["user"] == f"{os.getuid()}:{os.getgid()}"  # the owner of the keys
        if name == "deploy":
            expect_deploy(service["command"], root)
        else:
            assert service["shm_size"] == f"{memory_mb(plan, bundle, name)}mb"
            assert (service["hostname"], service["command"]) == (name, list(AGENT))
            expect_agent(plan, name, root / "etc/fovea")


def test_k8s_mounts_credentials_and_graph_where_they_are_read(
    bundle: Bundle, tmp_path: Path
) -> None:
    plan, text = load(bundle.graph), k8s(load(bundle.graph), bundle)
    documents = list(YAML(typ="safe").load_all(text))
    made = secrets_of(text)
    config = {d["metadata"]["name"]: d["data"] for d in documents if d["kind"] == "ConfigMap"}

    for document in documents:
        if document["kind"] not in ("Deployment", "Job"):
            continue
        pod = document["spec"]["template"]["spec"]
        root = tmp_path / "roots" / document["metadata"]["name"]
        words = mount(pod, root, made, config)
        if document["kind"] == "Job":
            expect_deploy(words, root)
        else:
            assert words == list(AGENT)
            expect_agent(plan, pod["hostname"], root / "etc/fovea")


def secrets_of(text: str) -> dict[str, dict[str, bytes]]:
    """Return the secrets that the printed commands make: the files of a folder, no subfolders."""
    made = {}
    for line in text.splitlines():
        words = shlex.split(line.removeprefix("# ")) if line.startswith("# kubectl create") else []
        if words:
            folder = Path(words[5].removeprefix("--from-file="))
            made[words[4]] = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
            assert all(re.fullmatch(r"[-._a-zA-Z0-9]+", key) for key in made[words[4]])
    return made


def mount(
    pod: dict[str, Any], root: Path, made: Mapping[str, Any], config: Mapping[str, Any]
) -> list[str]:
    """Lay a pod's volumes out below a folder; return the command of its container."""
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    (container,) = pod["containers"]
    for at in container["volumeMounts"]:
        volume = volumes[at["name"]]
        if "configMap" in volume:
            files = {k: v.encode() for k, v in config[volume["configMap"]["name"]].items()}
        elif "secret" in volume:
            files = made[volume["secret"]["secretName"]]
        else:
            files = projected(volume.get("projected", {"sources": []})["sources"], made)
        for name, data in files.items():
            path = root / at["mountPath"].removeprefix("/") / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            path.chmod(0o400)
    return list(container["command"])


def projected(sources: Sequence[Any], made: Mapping[str, Any]) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    for source in sources:
        data = made[source["secret"]["name"]]
        items = source["secret"].get("items") or [{"key": k, "path": k} for k in data]
        files.update({item["path"]: data[item["key"]] for item in items})
    return files


def test_k8s_has_a_pod_per_host_and_never_two_owners_of_a_sensor(bundle: Bundle) -> None:
    documents = list(YAML(typ="safe").load_all(k8s(load(bundle.graph), bundle)))

    kinds = [document["kind"] for document in documents]
    assert kinds == ["ConfigMap", *["Deployment", "Service"] * 3, "Job"]
    assert {d["spec"]["strategy"]["type"] for d in documents if d["kind"] == "Deployment"} == {
        "Recreate"
    }


def test_a_host_that_kubernetes_cannot_name_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, TRIO.replace("viewer", "Viewer_2"))

    with pytest.raises(GraphError, match="hosts: Viewer_2: expected small letters"):
        k8s(plan, Bundle(tmp_path / "graph.yaml", tmp_path, "alice"))


def test_a_host_with_the_name_of_the_service_that_deploys_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, TRIO.replace("viewer", "deploy"))

    with pytest.raises(GraphError, match="hosts: deploy: is the service that deploys; expected"):
        compose(plan, Bundle(tmp_path / "graph.yaml", tmp_path, "alice"))


def units(text: str) -> list[configparser.ConfigParser]:
    found = []
    for part in text.split("[Unit]")[1:]:
        unit = configparser.ConfigParser(strict=True, interpolation=None)
        unit.optionxform = str  # type: ignore[assignment,method-assign]
        unit.read_string(f"[Unit]{part}")
        assert unit["Install"]["WantedBy"] == "multi-user.target"
        assert Path(unit["Service"]["ExecStart"].split()[0]).is_absolute()
        found.append(unit)
    return found


def test_systemd_units_find_their_files_from_any_folder(bundle: Bundle) -> None:
    *agents, deploy = units(systemd(load(bundle.graph), bundle))

    assert len(agents) == 3
    for unit in agents:
        assert unit["Service"]["ExecStart"].endswith("agent --config /etc/fovea/agent.yaml")
        assert unit["Service"]["WorkingDirectory"] == "/etc/fovea"
    words = shlex.split(deploy["Service"]["ExecStart"])
    assert load(Path(words[2])).name == "trio"
    assert Credentials.of(Path(words[words.index("--credentials") + 1])).identity == "user.alice"
    assert all(Path(words[i]).is_absolute() for i in (0, 2, 4))
    assert Path(deploy["Service"]["WorkingDirectory"]) == Path.cwd()
    for label in ("sensor", "compute", "viewer"):
        assert f"{bundle.host_folder(label)} is to be /etc/fovea" in systemd(
            load(bundle.graph), bundle
        )
        expect_agent(load(bundle.graph), label, bundle.host_folder(label))


def test_the_unit_of_an_agent_has_the_state_folder_that_was_asked_for(tmp_path: Path) -> None:
    folder = tmp_path / "50% of $HOME"
    folder.mkdir()
    config, state = folder / "agent.yaml", folder / "what runs"
    config.write_text("label: eye\nstate: state\n")

    def service(*words: str) -> configparser.SectionProxy:
        words = ("--unit", f"--config={config}", *words)
        said = CliRunner().invoke(agent_command, words, catch_exceptions=False)
        (unit,) = units(said.output)
        return unit["Service"]

    own, asked = service(), service(f"--state={state}")

    assert words_of(own)[1:] == ["agent", "--config", str(config)]
    assert words_of(asked)[1:] == ["agent", "--config", str(config), "--state", str(state)]
    assert paths_of(own["ReadWritePaths"])[2:] == [str(folder / "state")]
    assert paths_of(asked["ReadWritePaths"])[2:] == [str(state)]
    assert asked["WorkingDirectory"] == str(folder).replace("%", "%%")


def words_of(service: Mapping[str, str]) -> list[str]:
    return [word.replace("$$", "$") for word in paths_of(service["ExecStart"])]


def paths_of(value: str) -> list[str]:
    return [word.replace("%%", "%") for word in shlex.split(value)]


def test_the_deploying_user_is_the_current_one_unless_another_is_given(bundle: Bundle) -> None:
    words = ["compose", str(bundle.graph), f"--credentials={bundle.credentials}"]

    own = CliRunner().invoke(export_command, words, catch_exceptions=False).output
    other = CliRunner().invoke(export_command, [*words, "--user=bob"], catch_exceptions=False)

    assert f"{bundle.credentials}/user.{default_user()}:" in own
    assert f"{bundle.credentials}/user.bob:" in other.output


def test_a_graph_without_hosts_is_one_service(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, ALONE)
    bundle = Bundle(tmp_path / "graph.yaml", tmp_path, "alice")

    (service,) = YAML(typ="safe").load(compose(plan, bundle))["services"].values()
    assert service["command"] == [
        "fovea", "run", "/etc/fovea/graph/graph.yaml", "--heartbeat", HEARTBEAT,
    ]  # fmt: skip
    assert service["volumes"] == [f"{bundle.graph}:/etc/fovea/graph/graph.yaml:ro"]
    (unit,) = units(systemd(plan, bundle))
    assert shlex.split(unit["Service"]["ExecStart"])[1:] == ["run", str(bundle.graph)]
    config, deployment = YAML(typ="safe").load_all(k8s(plan, bundle))
    root = tmp_path / "root"
    data = {config["metadata"]["name"]: config["data"]}
    words = mount(deployment["spec"]["template"]["spec"], root, {}, data)
    assert load(root / words[2].removeprefix("/")).name == "trio"


def test_credentials_and_agent_files_allow_what_the_graph_has_on_that_host_and_no_more(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "authority"
    secure.create(folder)

    addresses = {"sensor": "10.0.0.1", "compute": "10.0.0.2:7000", "viewer": "10.0.0.3"}
    lines = list(issue_for(folder, addresses, [plan_of(tmp_path)], ["alice"]))

    assert len(lines) == 4
    host = read(folder / "host.compute" / "agent.yaml")
    assert host.endpoint == "tls/10.0.0.2:7000"
    assert set(host.file.operators) == {
        "tests.samples:Pass",
        "tests.samples:Pair",
        "tests.samples:Steer",
    }
    assert set(host.file.operators) < set(ALLOWED)
    assert host.identities == ("user.alice", "host.sensor", "host.viewer")
    assert host.credentials is not None
    assert sorted(p.name for p in (folder / "host.compute" / "nodes").iterdir()) == [
        "node.trio.pair", "node.trio.steer", "node.trio.work",
    ]  # fmt: skip
    assert (folder / "ca.key").stat().st_mode & 0o077 == 0
    assert not list((folder / "host.compute").rglob("ca.key"))

    hosts = read_hosts((), folder / "user.alice", ["compute", "viewer"])
    assert hosts.points == {"compute": "tls/10.0.0.2:7000", "viewer": "tls/10.0.0.3:7447"}
    with pytest.raises(SettingsError, match="expected desk=ADDRESS"):
        read_hosts((), folder / "user.alice", ["desk"])


def test_credentials_that_are_not_there_are_named_and_how_they_are_made(tmp_path: Path) -> None:
    gone = tmp_path / "user.alice"
    said = f"^--credentials {gone}: no such folder; `fovea secure init` makes one$"

    with pytest.raises(SettingsError, match=said):
        read_hosts(["sensor=10.0.0.1"], gone, ["sensor", "compute"])


def test_a_host_without_an_address_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="expected --host viewer=ADDRESS, got none"):
        check_addressed(tmp_path, {"sensor": "a", "compute": "b"}, [plan_of(tmp_path)])


def test_a_new_host_that_no_graph_has_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    addresses = {"sensor": "a", "compute": "b", "viewer": "c", "snsor": "d"}

    with pytest.raises(SettingsError, match="--host snsor: no graph has it, did you mean 'sensor'"):
        check_addressed(tmp_path, addresses, [plan])

    check_addressed(tmp_path, addresses, [])  # hosts whose graphs come later
    (tmp_path / "host.snsor").mkdir()
    (tmp_path / "host.snsor" / "agent.yaml").write_text("label: snsor\n")
    check_addressed(tmp_path, addresses, [plan])  # a host of a graph that came before


@pytest.mark.parametrize(
    "addresses",
    [
        {"near": "10.0.0.1", "far": "10.0.0.1"},
        {"near": "10.0.0.1", "far": "10.0.0.1:7447"},
        {"far": "10.0.0.9:7000"},
    ],
)
def test_two_hosts_of_one_address_are_refused_before_anything_is_made(
    tmp_path: Path, addresses: dict[str, str]
) -> None:
    note = tmp_path / "user.alice" / secure.ADDRESSES
    note.parent.mkdir()
    note.write_text('{"old": "10.0.0.9:7000"}')

    with pytest.raises(SettingsError, match=r"--host far=\S+: expected an address or port of its"):
        check_addressed(tmp_path, addresses, [])


def test_hosts_of_one_machine_have_a_port_each(tmp_path: Path) -> None:
    check_addressed(tmp_path, {"near": "10.0.0.1:7447", "far": "10.0.0.1:7448"}, [])


def test_an_authority_is_made_once_and_credentials_have_one_identity(tmp_path: Path) -> None:
    secure.create(tmp_path / "ca")
    with pytest.raises(RunError, match="without an authority"):
        secure.create(tmp_path / "ca")

    credentials = secure.issue(tmp_path / "own", tmp_path / "ca", "host.sensor")
    assert credentials.identity == "host.sensor"
    credentials.key.chmod(0o644)
    with pytest.raises(SettingsError, match="only its owner can read"):
        secure.Credentials.of(credentials.folder)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "label: sensor\naddress: 10.0.0.1\n",
            r":2: address: 10\.0\.0\.1: a network address needs",
        ),
        ("label: ../x\n", r":1: label: expected up to 32 letters"),
        ("label: a\nboxes: [b]\n", r":2: boxes: renamed; expected hosts$"),
        ("label: a\npapers: .\n", r":2: papers: renamed; expected credentials$"),
        ("label: a\npeople: [b]\n", r":2: people: renamed; expected users$"),
        ("label: a\nopertors: {}\n", r"no such setting, did you mean 'operators'"),
        ("label: a\noperators: {a:B: yes}\n", r"operators"),
        (
            "label: a\ncredentials: .\naddress: h\nports: [9, 1]\n",
            r"ports: expected first and last",
        ),
    ],
)
def test_a_wrong_agents_file_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "agent.yaml"
    path.write_text(text)

    with pytest.raises(SettingsError, match=said):
        read(path)
