"""A process of a plan as its supervisor keeps it: the nodes, and who works there now."""

from collections import deque
from dataclasses import dataclass, field

from pipeline.graph.plan import Node
from pipeline.run.child import Child, Sample

MOST_SAMPLES = 7200


@dataclass
class Slot:
    """A process of the plan and its present incarnation."""

    name: str
    nodes: tuple[Node, ...]
    child: Child | None = None
    epoch: int = 0
    promised: int = 0  # the newest epoch that was given to anybody, who stands by included
    next_start_s: float = 0.0
    going_since_s: float = 0.0
    last_words: str = ""  # why it ended, the last time that it was known
    quick_deaths: int = 0  # in a row, each before it had run for a while
    deaths: deque[float] = field(default_factory=lambda: deque(maxlen=64))
    samples: deque[Sample] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))
    sources: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.promised = self.epoch

    def promise(self) -> int:
        """The epoch of another incarnation: nobody had it, nobody will."""
        self.promised = max(self.promised, self.epoch) + 1
        return self.promised
