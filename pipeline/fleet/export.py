"""`fovea export`: a graph's hosts for those who run their own engine: systemd, compose, Kubernetes.

Every host is an agent, whoever keeps it running, and `fovea up` places the graph on them. A graph
without hosts is one service that runs it. What is printed holds no secret: credentials are
mounted.
"""

import getpass
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO
from ruamel.yaml.scalarstring import walk_tree

from pipeline.fleet.manifests import manifests
from pipeline.fleet.shipping import (
    AGENT,
    ETC,
    GRAPH,
    IMAGE,
    STATE,
    USER,
    Desk,
    comments,
    credentials_words,
    memory_mb,
    run_words,
    up_words,
)
from pipeline.fleet.unit import agent_unit
from pipeline.graph.plan import Plan


def systemd(plan: Plan, desk: Desk) -> str:
    """Units: one per host, to be copied to it, and one that deploys from this one."""
    if not plan.hosts:
        return _titled(f"fovea-{plan.name}.service", _unit(["run", str(desk.graph)], plan.name))
    units = [
        _titled(
            f"{label}: fovea-agent.service; {desk.host_folder(label)} is to be {ETC} there, of the "
            "user fovea",
            agent_unit(Path(f"{ETC}/agent.yaml"), Path(f"{ETC}/state")),
        )
        for label in plan.hosts
    ]
    deploy = ["up", str(desk.graph), "--credentials", str(desk.own), "--replace"]
    unit = _unit(deploy, plan.name, once=True)
    return "\n".join([*units, _titled(f"here: fovea-{plan.name}.service (once)", unit)])


def compose(plan: Plan, desk: Desk) -> str:
    """A compose file: a service per host with its own shared memory, and one that deploys."""
    graph = f"{desk.graph}:{GRAPH}:ro"
    if not plan.hosts:
        return _yaml({"services": {plan.name: _service(plan, "", run_words(), graph)}})
    services = {
        label: {
            **_service(
                plan, label, AGENT, f"{desk.host_folder(label)}:{ETC}:ro", f"state-{label}:{STATE}"
            ),
            "hostname": label,
        }
        for label in plan.hosts
    }
    services["deploy"] = {
        **_common(),
        "command": up_words(plan), "restart": "on-failure",
        "volumes": [f"{desk.own}:{USER}:ro", graph], "depends_on": list(plan.hosts),
    }  # fmt: skip
    states: dict[str, Any] = {f"state-{label}": {} for label in plan.hosts}
    first = "".join(comments("before:", credentials_words(plan, desk)))
    return first + _yaml({"services": services, "volumes": states})


def k8s(plan: Plan, desk: Desk) -> str:
    """Manifests: per host a deployment of one pod and a headless service; a job that deploys."""
    first, documents = manifests(plan, desk)
    return first + "---\n".join(_yaml(document) for document in documents)


KINDS: Mapping[str, Callable[[Plan, Desk], str]] = {
    "systemd": systemd, "compose": compose, "k8s": k8s,
}  # fmt: skip


def engines() -> click.Choice[str]:
    """What a graph can be exported for."""
    return click.Choice(list(KINDS))


def _unit(words: Sequence[str], what: str, *, once: bool = False) -> str:
    """A unit of whoever sits here, in the folder he works in: his operators may lie there."""
    command = " ".join(map(_quoted, [str(Path(sys.executable).parent / "fovea"), *words]))
    return (
        f"[Unit]\nDescription=fovea {what}\nWants=network-online.target\n"
        "After=network-online.target\n\n"
        f"[Service]\nType={'oneshot' if once else 'exec'}\nExecStart={command}\n"
        f"WorkingDirectory={str(Path.cwd()).replace('%', '%%')}\nUser={getpass.getuser()}\n"
        f"Restart={'on-failure' if once else 'always'}\nRestartSec=2\n"
        "KillMode=mixed\nTimeoutStopSec=30\nNoNewPrivileges=yes\nLimitNOFILE=65536\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    )


def _quoted(word: str) -> str:
    """A word as systemd reads it.

    >>> _quoted("up"), _quoted("my graph.yaml"), _quoted("100%")
    ('up', '"my graph.yaml"', '100%%')
    """
    word = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if any(mark in word for mark in " '\"\t\\") else word


def _titled(title: str, text: str) -> str:
    return "".join(comments(title)) + text


def _service(plan: Plan, label: str, command: Sequence[str], *volumes: str) -> dict[str, Any]:
    return {
        **_common(), "command": list(command), "restart": "always",
        "shm_size": f"{memory_mb(plan, label)}mb", "volumes": list(volumes),
    }  # fmt: skip


def _common() -> dict[str, Any]:
    """Keys are readable for their owner only, whom root without capabilities is not."""
    return {
        "image": IMAGE, "init": True, "user": f"{os.getuid()}:{os.getgid()}",
        "cap_drop": ["ALL"], "security_opt": ["no-new-privileges:true"],
    }  # fmt: skip


def _yaml(document: Mapping[str, Any]) -> str:
    yaml, text = YAML(), StringIO()
    yaml.default_flow_style = False
    yaml.width = 1000
    plain = json.loads(json.dumps(document))
    walk_tree(plain)  # a graph file reads as it does elsewhere
    yaml.dump(plain, text)
    return str(text.getvalue())
