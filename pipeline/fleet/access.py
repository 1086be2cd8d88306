"""Access lists from a graph: what a node and an agent let others do, and nothing else."""

from collections.abc import Iterable, Sequence

from pipeline.bus.network import Permit
from pipeline.bus.outport import BYTES_SUFFIX
from pipeline.fleet.names import agent_key, host_identity, node_identity
from pipeline.graph.plan import Edge, Plan
from pipeline.node.wiring import key_of


def node_permits(plan: Plan, process: str) -> tuple[Permit, ...]:
    """Of a process: it publishes its outputs to their readers and hears its inputs' writers.

    What nodes answer (`@schema`, `@config`, …) is answered inside their host only.
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
    """Of an agent: each of the identities may ask it and tell it under a key of its own."""
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
    """Of a client of agents: it asks and publishes, and receives answers only."""
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
    """The key on which an edge crosses hosts."""
    return key_of(plan.name, edge.source, edge.output) + BYTES_SUFFIX
