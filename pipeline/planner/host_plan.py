"""Pictures that cross from host to host: plan and forecasts in, bytes a second of each pair out."""

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.forecast import Forecast
from pipeline.graph.plan import Plan
from pipeline.planner.links import LINKS, Verdict


@dataclass(frozen=True, kw_only=True)
class HostRow:
    """What one host sends another; every reader there gets it by itself."""

    source: str
    target: str
    edges: tuple[str, ...]  # node.input, whose messages are pictures of known size and rate
    bytes_per_s: float
    gige: Verdict


def host_rows(plan: Plan, told: Mapping[str, Forecast]) -> tuple[HostRow, ...]:
    """Return the pairs of hosts with pictures between them, of what is known."""
    found: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for edge in plan.edges:
        source, target = plan.node(edge.source).host, plan.node(edge.target).host
        stream = told[edge.source].streams.get(edge.output)
        if source != target and stream is not None and stream.bytes_per_s:
            found.setdefault((source, target), []).append((edge.end, stream.bytes_per_s))
    return tuple(
        HostRow(
            source=source, target=target, edges=tuple(end for end, _ in sent),
            bytes_per_s=(total := sum(need for _, need in sent)),
            gige=LINKS["gige"].verdict(total),
        ) for (source, target), sent in found.items()
    )  # fmt: skip
