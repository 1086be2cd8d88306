"""Draw a plan: as a Mermaid flow chart, or as lines for a terminal; `picture.py` draws SVG.

Message types need the operators' classes, which are imported; raises `GraphError`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pipeline.contract import Keep
from pipeline.graph.plan import Edge, Node, Plan, inputs_for

Live = Mapping[str, str]  # `node.input` -> what a running graph says of this edge


@dataclass(frozen=True, kw_only=True)
class Arrow:
    """An edge with what is written at it."""

    edge: Edge
    message: str  # class of the message
    keep: Keep  # the load policy in effect: in lockstep every edge is lossless
    live: str = ""

    @property
    def ports(self) -> str:
        """Output and input, as short as they can be told."""
        edge = self.edge
        return edge.input if edge.output == "out" else f"{edge.output} to {edge.input}"

    @property
    def told(self) -> str:
        """Type, load policy, sensor command, live figures."""
        age = [f"at most {self.edge.max_age_ms:g} ms old"] if self.edge.max_age_ms else []
        command = ["sensor command"] if self.edge.command else []
        live = [self.live] if self.live else []
        return ", ".join([self.message, self.keep, *age, *command, *live])


def arrows(plan: Plan, live: Live | None = None) -> list[Arrow]:
    """Return the edges of a plan, each with its message type."""
    inputs = {node.name: inputs_for(plan, node) for node in plan.nodes}
    return [
        Arrow(
            edge=edge,
            message=inputs[edge.target][edge.input].message.__name__,
            keep=inputs[edge.target][edge.input].keep,
            live=(live or {}).get(edge.end, ""),
        )
        for edge in plan.edges
    ]


def mermaid(plan: Plan, live: Live | None = None) -> str:
    """Return the text of the chart; hosts and groups become sub-graphs.

    Sensor commands are dotted and lossless edges thick.
    """
    lines = ["flowchart LR"]
    for host in dict.fromkeys(node.host for node in plan.nodes):
        lines += _of_host(plan, host)
    for arrow in arrows(plan, live):
        edge = arrow.edge
        line = "-.->" if edge.command else "==>" if arrow.keep == "every" else "-->"
        lines.append(f'  {edge.source} {line}|"{arrow.ports}<br/>{arrow.told}"| {edge.target}')
    return "\n".join(lines)


def listing(plan: Plan, live: Live | None = None) -> str:
    """Return a block of lines for each node, writers first, with what each input reads and how."""
    drawn = arrows(plan, live)
    return "\n".join(line for name in plan.order() for line in _block(plan.node(name), drawn))


def place(node: Node) -> str:
    """Return the host and the group of a node, as far as it has them."""
    placed = {"host": node.host, "group": node.group}
    return ", ".join(f"{kind} {name}" for kind, name in placed.items() if name)


def _of_host(plan: Plan, host: str) -> Iterator[str]:
    if host:
        yield f'  subgraph host_{host}["host {host}"]'
    for process, nodes in plan.processes().items():
        if nodes[0].host != host:
            continue
        if nodes[0].group:
            yield f'  subgraph group_{process}["group {process}"]'
        yield from (f"    {node.name}" for node in nodes)
        if nodes[0].group:
            yield "  end"
    if host:
        yield "  end"


def _block(node: Node, drawn: list[Arrow]) -> Iterator[str]:
    where = place(node)
    yield f"{node.name}  {node.operator}" + (f"  ({where})" if where else "")
    mine = [arrow for arrow in drawn if arrow.edge.target == node.name]
    for number, arrow in enumerate(mine, 1):
        corner = "└─" if number == len(mine) else "├─"
        yield f"  {corner} {arrow.edge.input} ← {arrow.edge.origin}  {arrow.told}"
