"""Client to supervisor: change or end the running graph. One order, one result or `Refused`."""

from typing import Any

from pipeline.graph.limits import BudgetMs, FrameCount, SomeFrames, Word
from pipeline.graph.plan import Plan
from pipeline.protocol.codec import ControlMessage, Kind, Part, Refused

GRAPH = "@graph"  # the key below a graph's own that takes orders
MOST_ORDER_BYTES = 4 << 20  # a plan of the most nodes and edges, with their settings


class SwapOrder(ControlMessage, frozen=True, kw_only=True):
    """Replace the operator, the settings or the model file of a node."""

    node: Word
    operator: Word = ""  # "": the same, with other settings or from a changed file
    changes: dict[str, Any] = {}
    defaults: bool = False  # do not keep the settings that the node has
    at: FrameCount = 0  # the cut comes at this frame or later
    shadow: FrameCount = 0
    probation: SomeFrames = 30
    budget_ms: BudgetMs = 0.0  # 0: three times the old operator's median


class PlanOrder(ControlMessage, frozen=True, kw_only=True):
    """Run this plan, made from the one of that revision."""

    plan: Plan
    revision: int


class StopOrder(ControlMessage, frozen=True):
    """End the graph as one SIGTERM would; a second order is in haste."""


class Difference(Part, frozen=True):
    """How a field of the answers differed."""

    frames: int
    most: float  # of numbers in arrays of equal shape


class ShadowReport(Part, frozen=True, kw_only=True):
    """How the successor answered the frames that its predecessor answered too."""

    frames: int = 0
    identical: int = 0
    missed: int = 0
    handler_ms: float = 0.0
    differences: dict[str, Difference] = {}  # by field


class SwapResult(ControlMessage, frozen=True, kw_only=True):
    """A swap that was carried out."""

    node: str
    hot: bool  # the successor stood by; else the node was stopped, then started
    gap_ms: float  # for so long the node stood still
    state: str
    proven_frames: int  # of probation
    ready_seq: int = -1  # hot: the newest frame when the successor was ready
    seq: int = -1  # hot: the last frame of the predecessor
    forgotten: list[str] = []  # attributes that changed while it ran and are in no state
    left_out: dict[str, int] = {}  # frames by input
    answered_ms: float = -1.0  # hot: from the cut to the successor's first answer; -1: none yet
    shadow: ShadowReport | None = None


class TopologyResult(ControlMessage, frozen=True, kw_only=True):
    """Nodes and edges that came and went."""

    added: list[str]
    removed: list[str]
    connected: list[str]
    cut: list[str]


class StopResult(ControlMessage, frozen=True, kw_only=True):
    """The graph is about to end: its sources, what is under way, then its processes."""

    graph: str
    pid: int  # of the supervisor


Order = SwapOrder | PlanOrder | StopOrder
Done = SwapResult | TopologyResult | StopResult
Result = SwapResult | TopologyResult | StopResult | Refused
ORDER: Kind[Order] = Kind("an order", Order, MOST_ORDER_BYTES)
RESULT: Kind[Result] = Kind("a result", Result)
__all__ = [
    "GRAPH", "ORDER", "RESULT", "Difference", "Done", "Order", "PlanOrder", "Refused", "Result",
    "ShadowReport", "StopOrder", "StopResult", "SwapOrder", "SwapResult", "TopologyResult",
]  # fmt: skip
