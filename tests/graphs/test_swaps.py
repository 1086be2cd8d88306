"""No shipped operator loses state in a swap: it declares all that changes while it runs."""

import pytest

from pipeline.contract import Source
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import graph_names, graph_path
from pipeline.node.operator_state import UndeclaredState
from pipeline.run.inline import InlineRunner

EXAMPLES = [name for name in graph_names() if name.startswith("examples/")]


def looks_at(runner: InlineRunner) -> dict[str, UndeclaredState]:
    """Watch the state of all operators but the source, whose state a swap never carries over."""
    operators = {node.name: runner.operator(node.name) for node in runner.plan.nodes}
    return {n: UndeclaredState(o) for n, o in operators.items() if not isinstance(o, Source)}


@pytest.mark.lengthy
@pytest.mark.parametrize("graph", ["tracking", *EXAMPLES])
def test_a_swap_of_a_shipped_operator_warns_of_nothing(graph: str) -> None:
    plan = load(graph_path(graph), Overlay(clock="lockstep"))
    with InlineRunner(plan) as runner:
        looks = looks_at(runner)

        list(runner.run(frames=12))

        lost = {name: look.names() for name, look in looks.items()}
    assert {name: names for name, names in lost.items() if names} == {}
