"""Messages from client to supervisor: each order gets one result or `Refused`."""

from typing import Any

from pipeline.graph.limits import BudgetMs, FrameCount, SomeFrames, Word
from pipeline.graph.plan import Plan
from pipeline.protocol.codec import ControlMessage, Kind, Part, Refused

GRAPH = "@graph"  # the key below a graph's own that receives orders
MOST_ORDER_BYTES = 4 << 20  # a plan of maximum size, with settings


class SwapOrder(ControlMessage, frozen=True, kw_only=True):
    """Replace the operator, the settings or the model file of a node."""

    node: Word
    operator: Word = ""  # "": the same class, with other settings or a changed file
    changes: dict[str, Any] = {}
    defaults: bool = False  # do not keep the settings that the node has
    at: FrameCount = 0  # earliest frame of the handover
    shadow: FrameCount = 0
    fresh: bool = False  # without the state of the old instance
    probation: SomeFrames = 30
    budget_ms: BudgetMs = 0.0  # 0: three times the old operator's median


class PlanOrder(ControlMessage, frozen=True, kw_only=True):
    """Change to this plan, which was derived from that revision."""

    plan: Plan
    revision: int


class StopOrder(ControlMessage, frozen=True):
    """Stop the graph as one SIGTERM would; a second order does not wait for messages."""


class Difference(Part, frozen=True):
    """The differences in one output field."""

    frames: int
    most: float  # largest difference in arrays of equal shape


class ShadowReport(Part, frozen=True, kw_only=True):
    """Comparison of the successor's outputs with its predecessor's on the same frames."""

    frames: int = 0
    identical: int = 0
    missed: int = 0
    handler_ms: float = 0.0
    differences: dict[str, Difference] = {}  # by field


class SwapResult(ControlMessage, frozen=True, kw_only=True):
    """The result of a completed swap."""

    node: str
    hot: bool  # the successor was on standby; else the node was stopped and started
    gap_ms: float  # how long the node paused
    state: str
    proven_frames: int  # frames of the probation
    ready_seq: int = -1  # hot: the latest frame when the successor was ready
    seq: int = -1  # hot: the last frame of the predecessor
    forgotten: list[str] = []  # attributes that changed at run time and are not in `state`
    left_out: dict[str, int] = {}  # frames by input
    answered_ms: float = -1.0  # hot: from the cut to the successor's first output; -1: none yet
    shadow: ShadowReport | None = None


class TopologyResult(ControlMessage, frozen=True, kw_only=True):
    """The nodes and edges that were added and removed."""

    added: list[str]
    removed: list[str]
    connected: list[str]
    cut: list[str]


class StopResult(ControlMessage, frozen=True, kw_only=True):
    """The graph is stopping: first its sources, then messages in flight, then its processes."""

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
