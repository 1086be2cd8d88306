"""`fovea export`: a graph's boxes for those who run their own engine: systemd, compose, Kubernetes.

Every box is an agent, whoever keeps it running, and `fovea up` places the graph on them. A graph
without hosts is one service that runs it. What is printed holds no secret: papers are mounted.
"""

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import click
from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO

from pipeline.fleet.names import PORT
from pipeline.graph.plan import Plan, slots

IMAGE = "fovea:latest"
LARGEST_FRAME_MB = 64  # per slot, where nobody knows how big pictures will be
SPARE_MB = 64
PAPERS = "/etc/fovea"


def systemd(plan: Plan, graph: str) -> str:
    """Units: one per box, to be copied to it, and one that deploys."""
    if not plan.hosts:
        return _section(f"fovea-{plan.name}.service", _unit(f"fovea run {graph}", plan.name))
    command = f"fovea agent --config {PAPERS}/agent.yaml"
    units = [
        _section(f"{label}: fovea-agent.service", _unit(command, f"box {label}"))
        for label in plan.hosts
    ]
    deploy = f"{_up(plan, graph)} --replace"
    units.append(_section(f"fovea-{plan.name}.service (once)", _unit(deploy, plan.name, once=True)))
    return "\n".join(units)


def compose(plan: Plan, graph: str) -> str:
    """A compose file: a service per box with its own shared memory, and one that deploys."""
    if not plan.hosts:
        services: dict[str, Any] = {plan.name: _service(plan, "", ["fovea", "run", graph])}
        return _yaml({"services": services})
    services = {
        label: {
            **_service(plan, label, ["fovea", "agent", "--config", f"{PAPERS}/agent.yaml"]),
            "hostname": label,
            "volumes": [f"./papers/box.{label}:{PAPERS}:ro", f"state-{label}:/tmp"],
        }
        for label in plan.hosts
    }
    services["deploy"] = {
        "image": IMAGE,
        "command": [*_up(plan, graph).split(), "--replace"],
        "volumes": [f"./papers/person:{PAPERS}/person:ro"],
        "depends_on": list(plan.hosts),
    }
    return _yaml({"services": services, "volumes": {f"state-{label}": {} for label in plan.hosts}})


def k8s(plan: Plan, graph: str) -> str:
    """Manifests: per box a deployment of one pod and a headless service, and a job that deploys."""
    if not plan.hosts:
        return _yaml(_deployment(plan, plan.name, ["fovea", "run", graph], papers=False))
    documents = []
    for label in plan.hosts:
        command = ["fovea", "agent", "--config", f"{PAPERS}/agent.yaml"]
        documents += [_deployment(plan, label, command, papers=True), _k8s_service(label)]
    job = _pod(plan, "deploy", [*_up(plan, graph).split(), "--replace"], papers=True)
    documents.append(
        {
            "apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": f"fovea-up-{plan.name}"},
            "spec": {"template": {"spec": {**job, "restartPolicy": "OnFailure"}}},
        }
    )  # fmt: skip
    return "---\n".join(_yaml(document) for document in documents)


KINDS: Mapping[str, Callable[[Plan, str], str]] = {
    "systemd": systemd, "compose": compose, "k8s": k8s,
}  # fmt: skip


def memory_mb(plan: Plan, label: str) -> int:
    """Shared memory that a box's frame pools may take, if every picture is the largest."""
    outputs = {(e.source, e.output) for e in plan.edges if plan.node(e.source).host == label}
    count = sum(slots(plan.readers(*output)) for output in outputs)
    return SPARE_MB + math.ceil(count * LARGEST_FRAME_MB)


def _up(plan: Plan, graph: str) -> str:
    hosts = ",".join(f"{label}={label}:{PORT}" for label in plan.hosts)
    return f"fovea up {graph} --papers {PAPERS}/person --hosts {hosts}"


def _unit(command: str, what: str, *, once: bool = False) -> str:
    kind = "oneshot" if once else "exec"
    again = "on-failure" if once else "always"
    return (
        f"[Unit]\nDescription=fovea {what}\nWants=network-online.target\n"
        "After=network-online.target\n\n"
        f"[Service]\nType={kind}\nExecStart={command}\nRestart={again}\nRestartSec=2\n"
        "KillMode=mixed\nTimeoutStopSec=30\nUser=fovea\nNoNewPrivileges=yes\nLimitNOFILE=65536\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    )


def _section(title: str, text: str) -> str:
    return f"# {title}\n{text}"


def _service(plan: Plan, label: str, command: list[str]) -> dict[str, Any]:
    return {
        "image": IMAGE, "command": command, "restart": "always", "init": True,
        "shm_size": f"{memory_mb(plan, label)}mb", "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
    }  # fmt: skip


def _deployment(plan: Plan, label: str, command: list[str], *, papers: bool) -> dict[str, Any]:
    labels = {"app": "fovea", "box": label}
    return {
        "apiVersion": "apps/v1", "kind": "Deployment", "metadata": {"name": f"fovea-{label}"},
        "spec": {
            "replicas": 1,
            "strategy": {"type": "Recreate"},  # a sensor has one owner
            "selector": {"matchLabels": labels},
            "template": {
                "metadata": {"labels": labels},
                "spec": {
                    **_pod(plan, label, command, papers=papers),
                    "nodeSelector": {"fovea/box": label},
                },
            },
        },
    }  # fmt: skip


def _pod(plan: Plan, label: str, command: list[str], *, papers: bool) -> dict[str, Any]:
    size = f"{memory_mb(plan, label if plan.hosts else '')}Mi"
    memory = {"name": "shm", "emptyDir": {"medium": "Memory", "sizeLimit": size}}
    secret = {"name": "papers", "secret": {"secretName": f"fovea-{label}", "defaultMode": 0o400}}
    mounts = [{"name": "shm", "mountPath": "/dev/shm"}]
    if papers:
        mounts.append({"name": "papers", "mountPath": PAPERS})
    return {
        "containers": [
            {
                "name": "fovea", "image": IMAGE, "command": command, "volumeMounts": mounts,
                "securityContext": {
                    "allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]},
                },
            }
        ],
        "volumes": [memory, *([secret] if papers else [])],
    }  # fmt: skip


def _k8s_service(label: str) -> dict[str, Any]:
    return {
        "apiVersion": "v1", "kind": "Service", "metadata": {"name": label},
        "spec": {"clusterIP": "None", "selector": {"app": "fovea", "box": label}},
    }  # fmt: skip


def _yaml(document: dict[str, Any]) -> str:
    yaml, text = YAML(), StringIO()
    yaml.default_flow_style = False
    yaml.width = 1000
    yaml.dump(json.loads(json.dumps(document)), text)
    return str(text.getvalue())


def engines() -> click.Choice[str]:
    """What a graph can be exported for."""
    return click.Choice(list(KINDS))
