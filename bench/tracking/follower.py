"""Which tracker measures: `--tracker` -> the plan of a graph with that class in it.

The class is the one that the graph names unless another is asked for; nothing that lies on the
machine decides it. A tracker that is asked for begins with its own settings.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.contract import settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, read_change
from pipeline.graph.plan import Plan, load_operator

NODE = "tracker"
TRACKERS = {
    "correlation": "operators.tracker:CorrelationTracker",
    "vittrack": "operators.tracker:VitTracker",
    "mixformer": "operators.tracker:MixFormerTracker",
}


def planned(graph: Path, changes: Sequence[str], tracker: str) -> Plan:
    """The plan, in lockstep; `tracker` is NAME, NAME=FILE.onnx or nothing: the graph's own."""
    name, _, weights = tracker.partition("=")
    given = [f"{NODE}.weights={weights}"] if weights else []
    plan = load(graph, Overlay(clock="lockstep"))
    if NODE not in {node.name for node in plan.nodes}:
        raise GraphError(f"{graph}: expected a node {NODE}, got none")
    path = TRACKERS.get(name, "") if name else plan.node(NODE).operator
    if not path:
        known = ", ".join(TRACKERS)
        raise SettingsError(f"tracker: expected {known} or NAME=FILE.onnx, got {tracker}")
    if path == plan.node(NODE).operator:
        return load(graph, Overlay(changes=(*changes, *given), clock="lockstep"))
    own = [change for change in (*changes, *given) if change.startswith(f"{NODE}.")]
    others = tuple(change for change in changes if not change.startswith(f"{NODE}."))
    values: dict[str, Any] = {}
    for change in own:
        _, setting, values[setting] = read_change(change)
    checked.build(settings_of(load_operator(path)), values, NODE)
    plan = load(graph, Overlay(changes=others, clock="lockstep"))
    nodes = [
        replace(node, operator=path, settings=values) if node.name == NODE else node
        for node in plan.nodes
    ]
    return replace(plan, nodes=tuple(nodes))
