"""End points and access lists of processes with edges to other hosts.

Of two connected processes, the first by name listens and the other one connects. Access lists are
derived from the graph: they permit what its nodes and agents need and nothing else.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence

from pipeline.bus.network import LOCAL, Network, Permit
from pipeline.bus.outport import BYTES_SUFFIX
from pipeline.errors import RunError
from pipeline.fleet.names import agent_key, host_identity, node_identity
from pipeline.fleet.placement import borders, listeners, place
from pipeline.fleet.secure import Credentials
from pipeline.graph.plan import Edge, Node, Plan
from pipeline.node.wiring import key_of
from pipeline.run.rundir import base

TIMEOUT_MS = 1000  # a shorter pause of a host loses nothing on a lossless edge


def node_permits(plan: Plan, process: str) -> tuple[Permit, ...]:
    """Return the permits of a process: send to its readers, receive from its writers.

    Questions to nodes (`@schema`, `@config`, …) are served on their own host only.
    """
    permits = []
    for edge in plan.edges:
        if not plan.crosses(edge):
            continue
        source, target = plan.node(edge.source), plan.node(edge.target)
        key = edge_key(plan, edge)
        if source.process == process:
            reader = node_identity(plan.name, target)
            permits.append(
                Permit(identity=reader, key=key, inward=("declare_subscriber",), outward=("put",))
            )
        if target.process == process:
            writer = node_identity(plan.name, source)
            permits.append(
                Permit(identity=writer, key=key, inward=("put",), outward=("declare_subscriber",))
            )
    return tuple(dict.fromkeys(permits))


def agent_permits(label: str, identities: Iterable[str]) -> tuple[Permit, ...]:
    """Return the permits of an agent: each identity may ask and publish under its own key."""
    return tuple(
        Permit(
            identity=identity,
            key=agent_key(label, identity, "**"),
            inward=("query", "put"),
            outward=("reply", "declare_queryable", "declare_subscriber"),
        )
        for identity in identities
    )


def asker_permits(identity: str, labels: Sequence[str]) -> tuple[Permit, ...]:
    """Return the permits of a client: it asks and publishes, and receives replies only."""
    return tuple(
        Permit(
            identity=host_identity(label),
            key=agent_key(label, identity, "**"),
            inward=("reply", "declare_queryable", "declare_subscriber"),
            outward=("query", "put"),
        )
        for label in labels
    )


def edge_key(plan: Plan, edge: Edge) -> str:
    """Return the key of an edge between hosts."""
    return key_of(plan.name, edge.source, edge.output) + BYTES_SUFFIX


def local_end_points(plan: Plan) -> dict[str, str]:
    """Return `label/process` -> a unix socket of this user."""
    stem = f"{LOCAL}{base()}/{plan.name}@{plan.here}"
    return {f"{plan.here}/{p}": f"{stem}.{p}.sock" for p in listeners(plan, plan.here)}


def end_points(
    plan: Plan, host: str, ports: Collection[int], used: Collection[str]
) -> dict[str, str]:
    """Return `label/process` -> a free port; raises `RunError` when there are too few."""
    names = [f"{plan.here}/{process}" for process in listeners(plan, plan.here)]
    free = [point for port in ports if (point := f"tls/{host}:{port}") not in used]
    if len(free) < len(names):
        raise RunError(
            f"{plan.name}: expected {len(names)} free ports of {min(ports)} to {max(ports)}, got "
            f"{len(free)}"
        )
    return dict(zip(names, free, strict=False))


def own_end_points(plan: Plan, free: Mapping[str, str], asked: Mapping[str, str]) -> dict[str, str]:
    """Return the end points of the processes here; raises `RunError` if one is missing."""
    lacking = sorted(set(free) - set(asked))
    if lacking:
        raise RunError(f"{plan.name}: no address for {lacking[0]}")
    return {name: asked[name] for name in free}


def check_credentials(plan: Plan, credentials: Credentials | None) -> None:
    """Raise `SettingsError` unless every process with edges to other hosts has credentials."""
    for node in filter(plan.is_here, plan.nodes):
        if credentials and place(node) in borders(plan):
            Credentials.of(credentials.folder / "nodes" / node_identity(plan.name, node))


def networks(
    plan: Plan, own: Mapping[str, str], theirs: Mapping[str, str], credentials: Credentials | None
) -> dict[str, Network]:
    """Return the networks of processes with edges to other hosts; raises `RunError`."""
    found = {}
    for node in plan.nodes:
        name = place(node)
        others = borders(plan).get(name, frozenset())
        if not others or not plan.is_here(node):
            continue
        lacking = [o for o in others if o < name and o not in theirs]
        if lacking:
            raise RunError(f"{plan.name}: no address for {lacking[0]}")
        folder = (
            credentials.folder / "nodes" / node_identity(plan.name, node) if credentials else None
        )
        found[node.process] = Network(
            listen=(own[name],) if name in own else (),
            connect=tuple(sorted(theirs[o] for o in others if o < name)),
            credentials=str(Credentials.of(folder).folder) if folder else "",
            permits=node_permits(plan, node.process),
            timeout_ms=TIMEOUT_MS if _promises(plan, node) else 0,
        )
    return found


def _promises(plan: Plan, node: Node) -> bool:
    """Whether the node's process has a lossless edge to another host."""
    mine = {n.name for n in plan.nodes if n.process == node.process and plan.is_here(n)}
    return any(e.source in mine and plan.lossless(e) and plan.crosses(e) for e in plan.edges)
