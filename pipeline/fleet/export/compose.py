"""`fovea export compose`: write a Compose file for the hosts of a graph."""

import os
from collections.abc import Sequence
from typing import Any

from pipeline.errors import GraphError
from pipeline.fleet.export.bundle import (
    AGENT,
    ALIVE,
    CHECK_S,
    ETC,
    GRAPH,
    IMAGE,
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
from pipeline.graph.plan import Plan

DEPLOY = "deploy"  # the service that runs `fovea up`


def compose(plan: Plan, bundle: Bundle) -> str:
    """Return a Compose file: a service per host with its shared memory, and one that deploys.

    Raises `GraphError` for a host with the name of the latter.
    """
    graph = f"{bundle.graph}:{GRAPH}:ro"
    if not plan.hosts:
        return to_yaml({"services": {plan.name: _service(plan, bundle, "", run_words(), graph)}})
    if DEPLOY in plan.hosts:
        raise GraphError(f"hosts: {DEPLOY}: is the service that deploys; expected another label")
    services = {
        label: {
            **_service(
                plan,
                bundle,
                label,
                AGENT,
                f"{bundle.host_folder(label)}:{ETC}:ro",
                f"state-{label}:{STATE}",
            ),
            "hostname": label,
        }
        for label in plan.hosts
    }
    services[DEPLOY] = {
        **_common(),
        "command": up_words(plan), "restart": "on-failure",
        "volumes": [f"{bundle.own}:{USER}:ro", graph], "depends_on": list(plan.hosts),
    }  # fmt: skip
    states: dict[str, Any] = {f"state-{label}": {} for label in plan.hosts}
    first = "".join(comments("before:", credentials_words(plan, bundle)))
    return first + to_yaml({"services": services, "volumes": states})


def _service(
    plan: Plan, bundle: Bundle, label: str, command: Sequence[str], *volumes: str
) -> dict[str, Any]:
    return {
        **_common(), "command": list(command), "restart": "always",
        "shm_size": f"{memory_mb(plan, bundle, label)}mb",
        "mem_limit": f"{most_mb(plan, bundle, label)}mb",
        "healthcheck": {
            "test": ["CMD", *ALIVE], "interval": f"{CHECK_S:.0f}s", "timeout": "5s", "retries": 3,
            "start_period": f"{START_S:.0f}s",
        },
        "volumes": list(volumes),
    }  # fmt: skip


def _common() -> dict[str, Any]:
    """Return common options; the user must own the keys, as root has no capabilities here."""
    return {
        "image": IMAGE, "init": True, "user": f"{os.getuid()}:{os.getgid()}",
        "cap_drop": ["ALL"], "security_opt": ["no-new-privileges:true"],
    }  # fmt: skip
