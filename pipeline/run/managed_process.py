"""State that the supervisor keeps per process of a plan: nodes, handle, restarts, samples."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from pipeline.graph.limits import RESTART
from pipeline.graph.plan import Node
from pipeline.run.process_handle import ProcessHandle, Sample

MOST_DEATHS = int(RESTART["most"].high) + 1  # that a rule may have to count
START_S = 60.0  # for an instance to start, unless one of its nodes may take longer
EARLY_SAMPLES, LATE_SAMPLES = 120, 600  # one sample per second


class Samples:
    """The first and the latest samples of a process; bounded, as a run may last for months.

    >>> samples = Samples()
    >>> for second in range(5000):
    ...     samples.append(Sample(second, 0, 50))
    >>> len(list(samples)), samples[-1].at_s, [s.at_s for s in samples][119:121]
    (720, 4999, [119, 4400])
    """

    def __init__(self) -> None:
        self._early: list[Sample] = []
        self._late: deque[Sample] = deque(maxlen=LATE_SAMPLES)

    def append(self, sample: Sample) -> None:
        """Append a sample."""
        (self._early if len(self._early) < EARLY_SAMPLES else self._late).append(sample)

    def __len__(self) -> int:
        return len(self._early) + len(self._late)

    def __getitem__(self, index: int) -> Sample:
        return list(self)[index] if index != -1 else (self._late or self._early)[-1]

    def __iter__(self) -> Iterator[Sample]:
        yield from self._early
        yield from self._late

    def __reversed__(self) -> Iterator[Sample]:
        yield from reversed(self._late)
        yield from reversed(self._early)


@dataclass
class ManagedProcess:
    """A process of the plan and its current instance."""

    name: str
    nodes: tuple[Node, ...]
    handle: ProcessHandle | None = None
    epoch: int = 0
    promised: int = 0  # the latest epoch given to any instance, including standbys
    next_start_s: float = 0.0
    going_since_s: float = 0.0
    last_words: str = ""  # the last known reason why it ended
    quick_deaths: int = 0  # consecutive ends after a short time
    deaths: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_DEATHS))
    samples: Samples = field(default_factory=Samples)
    sources: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.promised = self.epoch

    @property
    def start_limit_s(self) -> float:
        """How long another instance may take to start.

        >>> slow = Node(index=0, name="eye", operator="m:Eye", settings={}, start_s=90.0)
        >>> ManagedProcess("eye", (slow,)).start_limit_s
        90.0
        """
        return max([START_S, *(node.start_s for node in self.nodes)])

    def promise(self) -> int:
        """Return a new, unique epoch for the next instance."""
        self.promised = max(self.promised, self.epoch) + 1
        return self.promised
