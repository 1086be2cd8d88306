"""Message from predecessor to successor of a swap: position on every edge, and its state."""

from pipeline.bus.envelope_buffer import EdgeCut
from pipeline.bus.inbox import InboxPosition
from pipeline.protocol.codec import ControlMessage


class HandoverState(ControlMessage, frozen=True, kw_only=True):
    """What a predecessor passes to its successor."""

    edges: dict[str, EdgeCut]  # by input
    position: InboxPosition
    operator: str  # class of the predecessor, module:Class
    stopped_ns: int = 0  # monotonic
    state: str = ""  # a file in the memory folder, "" for none
    shadow: int = 0  # frames of a shadow run; the predecessor keeps running
    forgotten: list[str] = []  # attributes that changed at run time, if it has no `state`
