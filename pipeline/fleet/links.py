"""Where the processes of a plan listen for those on other hosts, and whom they connect to.

Of two processes that speak, the first by name listens and the other one connects.
"""

from collections.abc import Collection, Mapping

from pipeline.bus.network import LOCAL, Network
from pipeline.errors import RunError
from pipeline.fleet.access import node_permits
from pipeline.fleet.names import node_identity
from pipeline.fleet.placement import borders, listeners, place
from pipeline.fleet.secure import Credentials
from pipeline.graph.plan import Node, Plan
from pipeline.run.rundir import base

TIMEOUT_MS = 1000  # a host that naps for less loses nothing on a lossless edge


def local_end_points(plan: Plan) -> dict[str, str]:
    """`label/process` -> a unix socket of this user."""
    stem = f"{LOCAL}{base()}/{plan.name}@{plan.here}"
    return {f"{plan.here}/{p}": f"{stem}.{p}.sock" for p in listeners(plan, plan.here)}


def end_points(
    plan: Plan, host: str, ports: Collection[int], used: Collection[str]
) -> dict[str, str]:
    """`label/process` -> a free port of the host; raises `RunError` when there are too few."""
    names = [f"{plan.here}/{process}" for process in listeners(plan, plan.here)]
    free = [point for port in ports if (point := f"tls/{host}:{port}") not in used]
    if len(free) < len(names):
        raise RunError(
            f"{plan.name}: expected {len(names)} free ports of {min(ports)} to {max(ports)}, got "
            f"{len(free)}"
        )
    return dict(zip(names, free, strict=False))


def own_end_points(plan: Plan, free: Mapping[str, str], asked: Mapping[str, str]) -> dict[str, str]:
    """Where the processes here shall listen; raises `RunError` when that was not said."""
    lacking = sorted(set(free) - set(asked))
    if lacking:
        raise RunError(f"{plan.name}: no address for {lacking[0]}")
    return {name: asked[name] for name in free}


def check_credentials(plan: Plan, credentials: Credentials | None) -> None:
    """Raise `SettingsError` unless every process that speaks with other hosts has credentials."""
    for node in filter(plan.is_here, plan.nodes):
        if credentials and place(node) in borders(plan):
            Credentials.of(credentials.folder / "nodes" / node_identity(plan.name, node))


def networks(
    plan: Plan, own: Mapping[str, str], theirs: Mapping[str, str], credentials: Credentials | None
) -> dict[str, Network]:
    """By process, of those that speak with other hosts; raises `RunError` without an address."""
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
    """Whether the node's process sends anything across that may not be left out."""
    mine = {n.name for n in plan.nodes if n.process == node.process and plan.is_here(n)}
    return any(e.source in mine and e.keep == "every" and plan.crosses(e) for e in plan.edges)
