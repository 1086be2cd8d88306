"""Needs of a graph under another engine: memory, credentials, the deploying command."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO
from ruamel.yaml.scalarstring import walk_tree

from pipeline.bus.network import AGENT_PORT
from pipeline.fleet.names import user_identity
from pipeline.graph.plan import Plan, slots

IMAGE = "fovea:latest"
ETC = "/etc/fovea"  # credentials and agent.yaml of a host, as they are in its folder
GRAPH = f"{ETC}/graph/graph.yaml"
USER = f"{ETC}/user"
STATE = "/tmp"  # what runs, for the next start of the agent, lies beside the run folders
LARGEST_FRAME_MB = 64  # per slot, where nobody knows how big pictures will be
SPARE_MB = 64
AGENT = ("fovea", "agent", "--config", f"{ETC}/agent.yaml", "--state", f"{STATE}/state")


@dataclass(frozen=True)
class Bundle:
    """The files that an engine has to mount, and the deploying user. Paths are absolute."""

    graph: Path
    credentials: Path  # folder made by `fovea secure`
    user: str

    def host_folder(self, label: str) -> Path:
        """Return the folder with credentials and agent.yaml of a host."""
        return self.credentials / f"host.{label}"

    @property
    def own(self) -> Path:
        """The folder with the deploying user's credentials."""
        return self.credentials / user_identity(self.user)


def memory_mb(plan: Plan, label: str) -> int:
    """Return the shared memory for a host's frame pools in MB, if all pictures are the largest."""
    outputs = {(e.source, e.output) for e in plan.edges if plan.node(e.source).host == label}
    count = sum(slots(plan.readers(*output)) for output in outputs)
    return SPARE_MB + math.ceil(count * LARGEST_FRAME_MB)


def run_words() -> list[str]:
    """Return the command of a container for a graph without hosts."""
    return ["fovea", "run", GRAPH]


def up_words(plan: Plan) -> list[str]:
    """Return the command that deploys to hosts reachable by their labels."""
    hosts = ",".join(f"{label}={label}:{AGENT_PORT}" for label in plan.hosts)
    return ["fovea", "up", GRAPH, "--credentials", USER, "--hosts", hosts, "--replace"]


def credentials_words(plan: Plan, bundle: Bundle) -> list[str]:
    """Return the command that makes credentials for hosts reachable by their labels."""
    hosts = [f"--host={label}={label}" for label in plan.hosts]
    return ["fovea", "secure", "init", str(bundle.credentials), f"--graph={bundle.graph}", *hosts,
            f"--user={bundle.user}"]  # fmt: skip


def comments(*lines: str | Sequence[str]) -> Iterator[str]:
    """Yield comment lines; a sequence of words is a command to type."""
    for line in lines:
        yield f"# {line if isinstance(line, str) else shlex.join(line)}\n"


def to_yaml(document: Mapping[str, Any]) -> str:
    """Return a document as YAML text."""
    yaml, text = YAML(), StringIO()
    yaml.default_flow_style = False
    yaml.width = 1000
    plain = json.loads(json.dumps(document))
    walk_tree(plain)  # keeps graph files readable
    yaml.dump(plain, text)
    return str(text.getvalue())
