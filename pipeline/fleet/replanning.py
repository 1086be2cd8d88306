"""Nodes and edges of a deployed graph that come and go on this host, while all of it runs.

What may be added is what might have been deployed: the same checks hold. Edges between hosts stay
as they were deployed, since both hosts have opened what they need for them. So a change concerns
one host, and no other has to know of it.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec

from pipeline.codec import to_bytes
from pipeline.errors import FoveaError, RunError
from pipeline.fleet.hosted_graph import HostedGraph
from pipeline.fleet.store import GraphStore
from pipeline.graph.plan import Edge, Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode, encode, refused
from pipeline.protocol.orders import RESULT, PlanOrder, Refused

Inspect = Callable[[Plan, Mapping[str, str]], Plan]  # what it would run here; raises for what not
Ends = tuple[str, str, str, str]


def planned(hosted: HostedGraph, store: GraphStore) -> wire.Planned:
    """The plan that this host was asked to run, and which revision of it runs."""
    if hosted.supervisor is None:
        raise RunError(f"{hosted.plan.name}: does not run just now, try again")
    return wire.Planned(store.asked(hosted.plan.name).plan, hosted.supervisor.revision)


def change(
    hosted: HostedGraph, asked: wire.PlanChange, store: GraphStore, inspect: Inspect,
    reply: Callable[[bytes], None],
) -> None:  # fmt: skip
    """Have this host's part become another one and reply when it is; raises `FoveaError`."""
    name, supervisor = hosted.plan.name, hosted.supervisor
    if supervisor is None:
        raise RunError(f"{name}: does not run just now, try again")
    before = store.asked(name)
    check_inside(before.plan, asked.plan, hosted.plan.here)
    fingerprints = {**before.fingerprints, **asked.fingerprints}
    local = inspect(asked.plan, fingerprints)
    start = msgspec.structs.replace(
        before, plan=asked.plan, fingerprints=fingerprints, identity=identity_of(before)
    )

    def done(result: bytes) -> None:
        if not isinstance(decode(RESULT, result), Refused):
            hosted.plan = local
            try:
                store.keep(name, start)
            except FoveaError as error:
                reply(encode(refused(f"it was changed, but a restart will not know: {error}")))
                return
        reply(encode(wire.Relayed(result)))

    supervisor.control.ask(encode(PlanOrder(plan=local, revision=asked.revision)), done)


def check_inside(before: Plan, wanted: Plan, label: str) -> None:
    """Raise `RunError` for a change beyond the nodes of a host and the edges between them."""
    if replace(before, nodes=wanted.nodes, edges=wanted.edges) != wanted:
        raise RunError(f"{before.name}: expected another plan of the same graph")
    elsewhere = [[n for n in plan.nodes if n.host != label] for plan in (before, wanted)]
    if elsewhere[0] != elsewhere[1]:
        raise RunError(f"{before.name}: expected the nodes of other hosts as they are")
    beyond = [
        {(ends_of(e), e) for e in plan.edges if not is_inside(plan, e, label)}
        for plan in (before, wanted)
    ]
    if beyond[0] != beyond[1]:
        raise RunError(f"{before.name}: expected the edges of other hosts as they are")


def is_inside(plan: Plan, edge: Edge, label: str) -> bool:
    """Whether both ends of an edge are on that host."""
    return plan.node(edge.source).host == label == plan.node(edge.target).host


def ends_of(edge: Edge) -> Ends:
    """What an edge connects."""
    return edge.source, edge.output, edge.target, edge.input


def identity_of(start: wire.Start) -> str:
    """What hosts know a deployed graph by; it stays while nodes come and go."""
    return start.identity or hashlib.sha256(to_bytes(start.plan)).hexdigest()[:16]
