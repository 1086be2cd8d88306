"""Predecessor to successor of a swap: how far it came on every edge, and where its state lies."""

from pipeline.bus.envelope_buffer import EdgeCut
from pipeline.bus.inbox import InboxPosition
from pipeline.protocol.codec import ControlMessage


class HandoverState(ControlMessage, frozen=True, kw_only=True):
    """What the predecessor hands to its successor."""

    edges: dict[str, EdgeCut]  # by input
    position: InboxPosition
    operator: str  # class of the one that stopped, module:Class
    stopped_ns: int = 0  # monotonic
    state: str = ""  # file in the memory folder, "" for none
    shadow: int = 0  # frames to try before; the other works on
    forgotten: list[str] = []  # its attributes that changed while it ran, when it tells no state
