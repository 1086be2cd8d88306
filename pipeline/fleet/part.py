"""One box's part of a graph: a supervisor in a thread of its own, and its talk with other boxes."""

import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.bus.clocks import Clocks
from pipeline.bus.network import Network
from pipeline.errors import FoveaError, RunError
from pipeline.fleet.mirror import adopt
from pipeline.fleet.neighbour import Neighbour
from pipeline.fleet.wire import Accounts
from pipeline.graph.plan import Plan
from pipeline.node.wiring import CLOCKS
from pipeline.run.slot import Slot
from pipeline.run.supervisor import Supervisor

WAIT_FOR_OTHERS_S = 60.0  # then the source begins without them
TELL_S = 0.004  # how often accounts are looked at: the credit of lossless edges goes with it
ANYWAY_S = 0.25
STARTS_EPOCHS = 1000  # between two starts of a box, so that what an earlier one sent is told apart
log = logging.getLogger(__name__)


class PartSupervisor(Supervisor):
    """Runs the nodes that are here; its sources begin when the other boxes are ready too."""

    def __init__(self, plan: Plan, folder: str, first_epoch: int) -> None:
        super().__init__(plan, folder=folder, first_epoch=first_epoch)
        self.neighbours: tuple[Neighbour, ...] = ()
        self._since_s = time.monotonic()
        self.clocks = Clocks.create(self._run.folder / CLOCKS, plan.here, plan.hosts)

    @property
    def ready(self) -> bool:
        """Every process here has opened its operators."""
        return all(slot.child and slot.child.ready for slot in self.slots.values())

    def _may_go(self, slot: Slot) -> bool:
        waited = time.monotonic() - self._since_s > WAIT_FOR_OTHERS_S
        others = all(n.mirror.other_ready or n.lost for n in self.neighbours)
        return super()._may_go(slot) and (not slot.sources or waited or others)


@dataclass
class Part:
    """A part from its start to its end. `stop` may be called by any thread."""

    plan: Plan
    starts: int
    networks: Mapping[str, Network]
    boxes: Mapping[str, str]  # label -> end point of the agent
    way: Network  # to those agents, without end points
    phase: str = "starting"
    failure: str = ""
    supervisor: PartSupervisor | None = None
    neighbours: dict[str, Neighbour] = field(default_factory=dict)
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    @property
    def folder(self) -> str:
        """Its name among the graphs that run on this machine."""
        return f"{self.plan.name}@{self.plan.here}"

    def begin(self) -> None:
        """Run in a thread of its own."""
        self._thread = threading.Thread(target=self._run, name=f"part-{self.plan.name}")
        self._thread.start()

    def end(self) -> None:
        """Stop everything here and wait for it."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def hear(self, label: str, accounts: Accounts) -> None:
        """Another box tells of its accounts."""
        if (neighbour := self.neighbours.get(label)) is not None:
            neighbour.mirror.hear(accounts)

    def _run(self) -> None:
        try:
            supervisor = PartSupervisor(self.plan, self.folder, self.starts * STARTS_EPOCHS)
            with supervisor:
                self._keep(supervisor)
            self.phase = "stopped"
        except FoveaError as error:
            self._fail(str(error))
        except Exception as error:
            log.exception("%s: its supervisor broke", self.plan.name)
            self._fail(f"{type(error).__name__}: {error}")
        finally:
            self.supervisor = None

    def _fail(self, why: str) -> None:
        self.phase, self.failure = "failed", why
        log.error("%s: %s", self.plan.name, why)

    def _keep(self, supervisor: PartSupervisor) -> None:
        supervisor.networks = dict(self.networks)
        graph = self.plan.name
        self.neighbours = {
            label: Neighbour(
                graph,
                self.plan,
                supervisor.ledger,
                supervisor.clocks,
                label,
                point,
                self.way,
                self.starts,
            )
            for label, point in self.boxes.items()
        }
        supervisor.neighbours = tuple(self.neighbours.values())
        telling = threading.Thread(target=self._tell, args=(supervisor,), name=f"tell-{graph}")
        try:
            if self.starts > 1:
                told = [n.recall() for n in supervisor.neighbours]
                adopt(self.plan, supervisor.ledger, [t for t in told if t is not None])
            self.supervisor = supervisor
            for neighbour in supervisor.neighbours:
                neighbour.begin()
            telling.start()
            self._supervise(supervisor)
        finally:
            self._stop.set()
            if telling.is_alive():
                telling.join()
            for neighbour in supervisor.neighbours:
                neighbour.close()

    def _supervise(self, supervisor: PartSupervisor) -> None:
        supervisor.begin_all()
        while not self._stop.is_set():
            supervisor.tick()
            if supervisor.failure:
                raise RunError(supervisor.failure)
            if self.phase == "starting" and supervisor.all_going:
                self.phase = "running"
                log.info("%s: %d processes run", self.plan.name, len(supervisor.slots))

    def _tell(self, supervisor: PartSupervisor) -> None:
        anyway_s = 0.0
        while not self._stop.wait(TELL_S):
            now_s = time.monotonic()
            anyway = now_s - anyway_s > ANYWAY_S
            anyway_s = now_s if anyway else anyway_s
            for neighbour in supervisor.neighbours:
                neighbour.tell(ready=supervisor.ready, anyway=anyway)
