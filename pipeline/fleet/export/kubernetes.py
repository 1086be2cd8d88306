"""Kubernetes manifests of a graph: deployments, services, a job, and commands for their secrets.

A secret cannot contain folders, so every identity has its own, and a projected volume arranges them
as an agent expects.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.errors import GraphError
from pipeline.fleet.export.bundle import (
    AGENT,
    ALIVE,
    CHECK_S,
    ETC,
    GRAPH,
    IMAGE,
    OWN_MB,
    READY,
    REQUESTED_MB,
    START_S,
    STATE,
    USER,
    Bundle,
    comments,
    credentials_words,
    memory_mb,
    most_mb,
    run_words,
    to_yaml,
    up_words,
)
from pipeline.fleet.placement import identities
from pipeline.graph.plan import Plan

_DNS = re.compile(r"[a-z]([-a-z0-9]{0,61}[a-z0-9])?")
CREDENTIAL_FILES = ("ca.pem", "own.pem", "own.key")
Mount = tuple[dict[str, Any], dict[str, Any]]  # a volume and its mount in the container


def k8s(plan: Plan, bundle: Bundle) -> str:
    """Return manifests: per host a deployment of one pod and a headless service; a job."""
    first, documents = manifests(plan, bundle)
    return first + "---\n".join(to_yaml(document) for document in documents)


def manifests(plan: Plan, bundle: Bundle) -> tuple[str, list[dict[str, Any]]]:
    """Return commands to type first, and the documents; raises `GraphError` for a bad label."""
    graph = _config(plan, bundle)
    mounted = _volume(
        "graph", {"configMap": {"name": graph["metadata"]["name"]}}, str(Path(GRAPH).parent)
    )
    if not plan.hosts:
        pod = _pod(run_words(), [_memory(plan, bundle, ""), mounted], _watched(plan, bundle, ""))
        return "", [graph, _deployment(_slug(plan.name), pod)]
    documents = [graph]
    for label in plan.hosts:
        mounts = [_memory(plan, bundle, label), _credentials(plan, label), _state()]
        pod = {"hostname": _checked(label), **_pod(AGENT, mounts, _watched(plan, bundle, label))}
        pod["nodeSelector"] = {"fovea/host": label}
        documents += [_deployment(label, pod), _service(label)]
    secret = {"secret": {"secretName": _own_secret(plan), "defaultMode": 0o400}}
    pod = _pod(up_words(plan), [_volume("user", secret, USER), mounted])
    documents.append(
        {
            "apiVersion": "batch/v1", "kind": "Job",
            "metadata": {"name": f"fovea-up-{_slug(plan.name)}"},
            "spec": {"template": {"spec": {**pod, "restartPolicy": "OnFailure"}}},
        }
    )  # fmt: skip
    words = [credentials_words(plan, bundle), *_secrets(plan, bundle), *_machines(plan)]
    return "".join(comments("before:", *words)), documents


def _secrets(plan: Plan, bundle: Bundle) -> Iterator[Sequence[str]]:
    folders = [(_own_secret(plan), bundle.own)]
    for label in plan.hosts:
        folders.append((_secret(label), bundle.host_folder(label)))
        folders += [
            (_secret(label, number), bundle.host_folder(label) / "nodes" / identity)
            for number, identity in enumerate(identities(plan, label))
        ]
    for name, folder in folders:
        yield "kubectl", "create", "secret", "generic", name, f"--from-file={folder}"


def _machines(plan: Plan) -> Iterator[Sequence[str]]:
    for label in plan.hosts:
        yield "kubectl", "label", "node", f"MACHINE-OF-{label}", f"fovea/host={label}"


def _credentials(plan: Plan, label: str) -> Mount:
    sources: list[dict[str, Any]] = [{"secret": {"name": _secret(label)}}]
    for number, identity in enumerate(identities(plan, label)):
        items = [{"key": name, "path": f"nodes/{identity}/{name}"} for name in CREDENTIAL_FILES]
        sources.append({"secret": {"name": _secret(label, number), "items": items}})
    projected = {"projected": {"sources": sources, "defaultMode": 0o400}}
    return _volume("credentials", projected, ETC)


def _memory(plan: Plan, bundle: Bundle, label: str) -> Mount:
    limit = f"{memory_mb(plan, bundle, label)}Mi"
    memory = {"emptyDir": {"medium": "Memory", "sizeLimit": limit}}
    return _volume("shm", memory, "/dev/shm")


def _state() -> Mount:
    return _volume("state", {"emptyDir": {}}, STATE)


def _volume(name: str, kind: dict[str, Any], folder: str) -> Mount:
    return {"name": name, **kind}, {"name": name, "mountPath": folder}


def _watched(plan: Plan, bundle: Bundle, label: str) -> dict[str, Any]:
    """Return probes and resources of a host.

    Its processor time is not limited: a container that has used up its share stands still for the
    rest of 100 ms, which is three frames.
    """
    count = sum(node.host == label for node in plan.nodes)
    return {
        "startupProbe": _probe(ALIVE, 1.0, START_S),
        "livenessProbe": _probe(ALIVE, CHECK_S, 3 * CHECK_S),
        "readinessProbe": _probe(READY, CHECK_S / 2, CHECK_S / 2),
        "resources": {
            "requests": {"cpu": f"{100 * count}m", "memory": f"{OWN_MB + REQUESTED_MB * count}Mi"},
            "limits": {"memory": f"{most_mb(plan, bundle, label)}Mi"},
        },
    }


def _probe(command: Sequence[str], every_s: float, within_s: float) -> dict[str, Any]:
    return {
        "exec": {"command": list(command)}, "periodSeconds": round(every_s), "timeoutSeconds": 5,
        "failureThreshold": round(within_s / every_s),
    }  # fmt: skip


def _pod(
    command: Sequence[str], mounts: Sequence[Mount], watched: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    return {
        "containers": [
            {
                "name": "fovea", "image": IMAGE, "command": list(command), **(watched or {}),
                "volumeMounts": [mount for _, mount in mounts],
                "securityContext": {
                    # keys must be readable by their owner only, and root owns secrets
                    "runAsUser": 0,
                    "allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]},
                },
            }
        ],
        "volumes": [volume for volume, _ in mounts],
    }  # fmt: skip


def _deployment(name: str, pod: dict[str, Any]) -> dict[str, Any]:
    labels = {"app": "fovea", "host": name}
    return {
        "apiVersion": "apps/v1", "kind": "Deployment", "metadata": {"name": f"fovea-{name}"},
        "spec": {
            "replicas": 1,
            "strategy": {"type": "Recreate"},  # only one process can open a sensor
            "selector": {"matchLabels": labels},
            "template": {"metadata": {"labels": labels}, "spec": pod},
        },
    }  # fmt: skip


def _service(label: str) -> dict[str, Any]:
    return {
        "apiVersion": "v1", "kind": "Service", "metadata": {"name": label},
        "spec": {
            "clusterIP": "None", "publishNotReadyAddresses": True,
            "selector": {"app": "fovea", "host": label},
        },
    }  # fmt: skip


def _config(plan: Plan, bundle: Bundle) -> dict[str, Any]:
    return {
        "apiVersion": "v1", "kind": "ConfigMap",
        "metadata": {"name": f"fovea-{_slug(plan.name)}"},
        "data": {Path(GRAPH).name: bundle.graph.read_text()},
    }  # fmt: skip


def _secret(label: str, number: int | None = None) -> str:
    return f"fovea-{label}" if number is None else f"fovea-{label}.{number}"


def _own_secret(plan: Plan) -> str:
    return f"fovea-up-{_slug(plan.name)}"


def _checked(label: str) -> str:
    if not _DNS.fullmatch(label):
        raise GraphError(
            f"hosts: {label}: expected small letters, digits and -, a letter first, as services "
            "of Kubernetes are named"
        )
    return label


def _slug(name: str) -> str:
    """Return a name that is valid in Kubernetes.

    >>> _slug("My_graph.2")
    'my-graph-2'
    """
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "graph"
