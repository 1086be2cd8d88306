"""The plan of a deployed graph: merged from its hosts' plans, and split into them again."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from pipeline.errors import GraphError
from pipeline.fleet.hosted_graph import ends_of, is_inside
from pipeline.graph.plan import Edge, Node, Plan

Item = TypeVar("Item", Node, Edge)


def merged(plans: Mapping[str, Plan]) -> Plan:
    """Return the whole plan: the nodes of every host and the edges that end at them."""
    first = next(iter(plans.values()))
    nodes = [n for label, plan in plans.items() for n in plan.nodes if n.host == label]
    edges = [
        e for label, plan in plans.items() for e in plan.edges if plan.node(e.target).host == label
    ]
    return replace(first, nodes=tuple(_fresh(nodes, ())), edges=tuple(_fresh(edges, ())))


def changed(before: Plan, wanted: Plan, plans: Mapping[str, Plan]) -> dict[str, Plan]:
    """Return the new plan of every host that changes; raises `GraphError`."""
    was, shall = ({ends_of(e): e for e in plan.edges} for plan in (before, wanted))
    for ends in sorted(was.keys() ^ shall.keys(), key=lambda ends: (ends in shall, ends)):
        plan, edge = (wanted, shall[ends]) if ends in shall else (before, was[ends])
        _check_inside(plan, edge, "added" if ends in shall else "cut")
    old, new = {n.name for n in before.nodes}, {n.name for n in wanted.nodes}
    found = {}
    for label, plan in plans.items():
        held = {ends_of(e): e for e in plan.edges if is_inside(plan, e, label)}
        inside = {ends_of(e): e for e in wanted.edges if is_inside(wanted, e, label)}
        gone = {n.name for n in plan.nodes if n.host == label} - new
        fresh = [n for n in wanted.nodes if n.host == label and n.name not in old]
        if not gone and not fresh and held.keys() == inside.keys():
            continue
        nodes = [n for n in plan.nodes if n.name not in gone]
        nodes += _fresh(fresh, {n.index for n in nodes})
        edges = [e for e in plan.edges if ends_of(e) not in held or ends_of(e) in inside]
        comes = [e for ends, e in inside.items() if ends not in held]
        edges += _fresh(comes, {e.index for e in edges})
        found[label] = replace(plan, nodes=tuple(nodes), edges=tuple(edges))
    return found


def _check_inside(plan: Plan, edge: Edge, verb: str) -> None:
    source, target = plan.node(edge.source), plan.node(edge.target)
    if source.host != target.host:
        raise GraphError(
            f"{plan.name}: {edge.origin} is on {source.host}, {edge.end} on {target.host}: an edge "
            f"between hosts cannot be {verb} while the graph runs; change the graph's file and "
            "bring it up again with `fovea up FILE --replace`"
        )


def _fresh(items: Iterable[Item], taken: Collection[int]) -> list[Item]:
    """Return the items with the lowest free numbers."""
    free = (number for number in range(1 << 16) if number not in taken)
    return [replace(item, index=next(free)) for item in items]
