"""The classes that are measured: `--tracker` and `--policy` -> the plan of a graph with them in it.

The graph's own class is used unless another is asked for, whatever files the machine has. A tracker
that is asked for begins with its own settings. A policy that is asked for keeps the settings of the
graph that both classes have.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.contract import settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, read_change
from pipeline.graph.plan import Plan, load_operator

TRACKER, POLICY = "tracker", "policy"  # nodes
TRACKERS = {
    "correlation": "operators.tracker:CorrelationTracker",
    "template": "operators.tracker:TemplateTracker",
    "vittrack": "operators.tracker:VitTracker",
    "mixformer": "operators.tracker:MixFormerTracker",
}
LEARNED = "operators.policy:LearnedPolicy"
POLICIES = {
    "pursuit": "operators.policy:PursuitPolicy",
    "round_robin": "operators.policy:RoundRobinPolicy",
    "greedy": "operators.policy:GreedyPolicy",
}


def planned(
    graph: Path,
    changes: Sequence[str],
    tracker: str = "",
    policy: str = "",
    source: Path | None = None,
) -> Plan:
    """Return the plan, in lockstep, with the graph's own classes where no other is asked for.

    `source` is laid over the graph's own. `tracker` is NAME or NAME=FILE.onnx, `policy` one of
    `POLICIES` or FILE.onnx.
    """
    other = tuple(c for c in changes if c.partition(".")[0] not in (TRACKER, POLICY))
    plan = load(graph, Overlay(source=source, changes=other, clock="lockstep"))
    known = {node.name: node.operator for node in plan.nodes}
    for node in (*([TRACKER] if tracker else []), *([POLICY] if policy else [])):
        if node not in known:
            raise GraphError(f"{graph}: expected a node {node}, got none")
    paths = {TRACKER: _tracker(tracker) or known[TRACKER]} if TRACKER in known else {}
    weights = {TRACKER: tracker.partition("=")[2], POLICY: ""}
    if policy:
        paths[POLICY] = POLICIES.get(policy, LEARNED)
        weights[POLICY] = "" if policy in POLICIES else policy
    given = [*changes, *(f"{node}.weights={file}" for node, file in weights.items() if file)]
    others = {node for node, path in paths.items() if path != known[node]}
    own = {node: _values(given, node) for node in others}
    kept = tuple(change for change in given if change.partition(".")[0] not in others)
    plan = load(graph, Overlay(source=source, changes=kept, clock="lockstep"))
    for node in sorted(others):
        values = own[node]
        if node == POLICY:
            values = _shared(known[node], paths[node], plan.node(node).settings, values)
        checked.build(settings_of(load_operator(paths[node])), values, node)
        plan = with_class(plan, node, paths[node], values)
    return plan


def with_class(plan: Plan, name: str, operator: str, settings: Mapping[str, Any]) -> Plan:
    """Return the plan with another class at a node."""
    nodes = [
        replace(node, operator=operator, settings=dict(settings)) if node.name == name else node
        for node in plan.nodes
    ]
    return replace(plan, nodes=tuple(nodes))


def check_prompted(plan: Plan) -> None:
    """Raise `SettingsError` unless the policy can be given a target by a box."""
    operator = plan.node(POLICY).operator
    if "prompt_box" not in _names(operator):
        raise SettingsError(
            f"{POLICY}.operator: expected a class with a setting prompt_box, got {operator}"
        )


def _tracker(word: str) -> str:
    name = word.partition("=")[0]
    if name and name not in TRACKERS:
        known = ", ".join(TRACKERS)
        raise SettingsError(f"tracker: expected {known} or NAME=FILE.onnx, got {word}")
    return TRACKERS.get(name, "")


def _values(changes: Sequence[str], node: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for change in changes:
        if change.startswith(f"{node}."):
            _, setting, found[setting] = read_change(change)
    return found


def _shared(
    before: str, after: str, settings: Mapping[str, Any], changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Return settings for the class `after`, without those that only the class `before` has."""
    alone = _names(before) - _names(after)
    left_out = {name: value for name, value in changes.items() if name in alone}
    checked.build(settings_of(load_operator(before)), {**settings, **left_out}, POLICY)
    return {n: v for n, v in {**settings, **changes}.items() if n not in alone}


def _names(operator: str) -> set[str]:
    return {f.name for f in fields(settings_of(load_operator(operator)))}
