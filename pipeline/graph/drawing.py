"""Draw a plan as a Mermaid flow chart: sensor commands dotted, lossless edges thick."""

from pipeline.graph.plan import Plan


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
