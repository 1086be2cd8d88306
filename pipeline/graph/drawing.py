"""Draw a plan: as a Mermaid flow chart, or as lines for a terminal.

In the chart sensor commands are dotted and lossless edges thick.
"""

from collections.abc import Iterator

from pipeline.contract import Keep
from pipeline.graph.plan import Edge, Node, Plan, inputs_for


def mermaid(plan: Plan) -> str:
    """Return the text of the chart; groups become sub-graphs."""
    lines = ["flowchart LR"]
    for process, nodes in plan.processes().items():
        if len(nodes) == 1 and not nodes[0].group:
            lines.append(f"  {nodes[0].name}")
            continue
        lines.append(f"  subgraph {process}")
        lines += [f"    {node.name}" for node in nodes]
        lines.append("  end")
    for edge in plan.edges:
        label = edge.input if edge.output == "out" else f"{edge.output} to {edge.input}"
        arrow = "-.->" if edge.command else "==>" if edge.keep == "every" else "-->"
        lines.append(f"  {edge.source} {arrow}|{label}| {edge.target}")
    return "\n".join(lines)


def listing(plan: Plan) -> str:
    """Return a block of lines for each node, writers first, with what each input reads and how.

    Message types need the operators' classes, which are imported; raises `GraphError`.
    """
    return "\n".join(line for name in plan.order() for line in _block(plan, plan.node(name)))


def _block(plan: Plan, node: Node) -> Iterator[str]:
    placed = {"host": node.host, "group": node.group}
    where = ", ".join(f"{kind} {name}" for kind, name in placed.items() if name)
    yield f"{node.name}  {node.operator}" + (f"  ({where})" if where else "")
    edges, inputs = plan.inputs(node.name), inputs_for(plan, node)
    for number, (name, edge) in enumerate(edges.items(), 1):
        corner = "└─" if number == len(edges) else "├─"
        kind = inputs[name].message.__name__
        yield f"  {corner} {name} ← {edge.origin}  {kind}, {_policy(edge, inputs[name].keep)}"


def _policy(edge: Edge, keep: Keep) -> str:
    """Return how an edge is read: its load policy, and whether it is the sensor command.

    `keep` is the policy in effect: in lockstep every edge is lossless.
    """
    age = [f"at most {edge.max_age_ms:g} ms old"] if edge.max_age_ms else []
    command = ["sensor command"] if edge.command else []
    return ", ".join([keep, *age, *command])
