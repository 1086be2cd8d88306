"""Needs of a graph under another engine: memory, credentials, commands, checks of its health."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO
from ruamel.yaml.scalarstring import walk_tree

from pipeline.bus.network import AGENT_PORT
from pipeline.contract import outputs_of
from pipeline.fleet.names import user_identity
from pipeline.graph.plan import Plan, load_operator, slots
from pipeline.messages import Frame
from pipeline.run.heartbeat import WORKS

IMAGE = "fovea:latest"
ETC = "/etc/fovea"  # credentials and agent.yaml of a host, as they are in its folder
GRAPH = f"{ETC}/graph/graph.yaml"
USER = f"{ETC}/user"
STATE = "/tmp"  # what runs, for the next start of the agent, lies beside the run folders
HEARTBEAT = "/dev/shm/heartbeat"  # in memory: it is written once a second
# without an interpreter: each takes 2 ms of a core, `fovea health` takes half a second
# renewed within 30 s; no shell, since podman joins the words of a probe with spaces
ALIVE = ("find", HEARTBEAT, "-mmin", "+0.5", "-exec", "false", "{}", "+")
READY = ("grep", "-qx", WORKS, HEARTBEAT)
START_S = 60.0  # for the first heartbeat, which an interpreter on a slow board takes to write
CHECK_S = 10.0
LARGEST_FRAME_MB = 64  # per slot, where no setting tells how large the pictures will be
MESSAGE_MB = 1  # per slot of another message
SPARE_MB = 64
# the shipped nodes take 65 to 300 MB each
REQUESTED_MB, MOST_MB = 128, 1024  # of a node that does not say its `memory_mb`
OWN_MB = 512  # of agent or supervisor, which import operators, and of a spare process
AGENT = (
    "fovea", "agent", "--config", f"{ETC}/agent.yaml", "--state", f"{STATE}/state",
    "--heartbeat", HEARTBEAT,
)  # fmt: skip


@dataclass(frozen=True)
class Bundle:
    """The files that an engine has to mount, and the deploying user. Paths are absolute."""

    graph: Path
    credentials: Path  # folder made by `fovea secure`
    user: str
    pool_bytes: Mapping[str, int] = field(default_factory=dict)  # `node.output`: where it is known

    def host_folder(self, label: str) -> Path:
        """Return the folder with credentials and agent.yaml of a host."""
        return self.credentials / f"host.{label}"

    @property
    def own(self) -> Path:
        """The folder with the deploying user's credentials."""
        return self.credentials / user_identity(self.user)


def memory_mb(plan: Plan, bundle: Bundle, label: str) -> int:
    """Return the shared memory for a host's frame pools in MB.

    While a node is swapped, its successor has pools beside the old ones.
    """
    outputs = {(e.source, e.output) for e in plan.edges if plan.node(e.source).host == label}
    return SPARE_MB + math.ceil(2 * sum(_pool_mb(plan, bundle, *output) for output in outputs))


def _pool_mb(plan: Plan, bundle: Bundle, node: str, output: str) -> float:
    readers = plan.readers(node, output)
    if (known := bundle.pool_bytes.get(readers[0].origin)) is not None:
        return known / 1e6
    message = outputs_of(load_operator(plan.node(node).operator))[output]
    return slots(readers) * (LARGEST_FRAME_MB if issubclass(message, Frame) else MESSAGE_MB)


def most_mb(plan: Plan, bundle: Bundle, label: str) -> int:
    """Return the limit of a host's memory in MB: its nodes', the agent's and the frame pools'."""
    nodes = [node for node in plan.nodes if node.host == label]
    own = sum(node.memory_mb or MOST_MB for node in nodes)
    return OWN_MB + math.ceil(own) + memory_mb(plan, bundle, label)


def run_words() -> list[str]:
    """Return the command of a container for a graph without hosts."""
    return ["fovea", "run", GRAPH, "--heartbeat", HEARTBEAT]


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
