"""Targets of `bench.chaos`: a graph on this host, or one over three hosts.

Both provide what a check of recovery needs and, after the end, the leftovers.
"""

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

from bench.hosts import World
from bench.leftovers import Traces, leftover_files, run_for, unbalanced
from pipeline.bus.histogram import Histogram
from pipeline.bus.ledger import Ledger, NodeAccount
from pipeline.graph.plan import Plan, sources
from pipeline.private_folder import PrivateFolder
from pipeline.run.memory_folder import MEMORY, path_of
from pipeline.run.report import compose
from pipeline.run.supervisor import Supervisor

SETTLE_S = 5.0  # after the last fault, before accounts are checked
LOOK_S = 0.005


class Ground(ABC):
    """A running graph, used as a context manager."""

    kinds: Mapping[str, float]  # kind of fault -> share
    names: tuple[str, ...]  # of its processes
    hosts: tuple[str, ...] = ()  # that can be disconnected
    failure = ""

    @property
    @abstractmethod
    def commands(self) -> Histogram:
        """The histogram that counts the commands which the sensor accepts."""

    @abstractmethod
    def accounts(self, victim: str) -> list[NodeAccount]:
        """Return the accounts of the nodes of a process, or of all nodes on a host."""

    @abstractmethod
    def pid(self, name: str) -> int:
        """Return the id of a process, 0 while it does not run."""

    @abstractmethod
    def restarts(self) -> int:
        """Return the number of restarts of all processes."""

    def load_s(self, name: str) -> float:
        """Return how long a process took to open models and devices; 0 where it is not known."""
        return 0.0

    def link(self, host: str, *, up: bool) -> None:
        """Disconnect a host, or connect it again."""
        raise NotImplementedError

    @abstractmethod
    def look(self) -> None:
        """Let the graph run for a moment."""

    def run_for(self, seconds: float) -> None:
        """Let the graph run for so many seconds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.look()

    @abstractmethod
    def end(self) -> dict[str, Any]:
        """Stop the graph; return its figures, unbalanced edges, orphans and leftover files."""


class OneHost(Ground):
    """A graph under a supervisor in this process."""

    kinds = {"kill": 0.4, "volley": 0.1, "freeze": 0.25, "nap": 0.25}

    def __init__(self, plan: Plan) -> None:
        self._supervisor = Supervisor(plan)
        self._plan, self.names = plan, tuple(plan.processes())
        self._ended = False

    def __enter__(self) -> "OneHost":
        self._supervisor.__enter__()
        self._supervisor.allow_restarts(1_000_000)
        self._supervisor.start()
        self._traces = Traces.of(self._plan.name)
        return self

    def __exit__(self, *caught: Any) -> None:
        if not self._ended:
            self._ended = True
            self._supervisor.__exit__(*caught)

    @property
    def commands(self) -> Histogram:
        """The histogram of the source."""
        source = next(sources(self._plan))
        return self._supervisor.ledger.nodes[source.index].histograms["loop"]

    def accounts(self, victim: str) -> list[NodeAccount]:
        """Return the accounts of the nodes of a process."""
        nodes = self._plan.processes()[victim]
        return [self._supervisor.ledger.nodes[n.index] for n in nodes]

    def pid(self, name: str) -> int:
        """Return the process id that the supervisor knows."""
        return self._supervisor.pid(name)

    def restarts(self) -> int:
        """Return the restarts that the supervisor counted."""
        return sum(self._supervisor.restarts.values())

    def load_s(self, name: str) -> float:
        """Return the loading time that the process reported."""
        return self._supervisor.load_s(name)

    def look(self) -> None:
        """Run one tick of the supervisor."""
        self._supervisor.tick()
        self.failure = self._supervisor.failure

    def end(self) -> dict[str, Any]:
        """Drain and stop the graph; return its checks and figures."""
        run_for(self._supervisor, SETTLE_S)
        duration_s = time.monotonic() - self._supervisor.started_s
        self._supervisor.finish()
        self._supervisor.stop()
        report = compose(self._plan, self._supervisor.ledger, {}, {}, duration_s=duration_s)
        self.__exit__(None, None, None)
        return {
            "unbalanced": unbalanced(report["edges"]), "orphans": self._traces.orphans(),
            "left": self._traces.files(), "loop": report["loop"], "edges": report["edges"],
        }  # fmt: skip


class ThreeHosts(Ground):
    """A graph over network namespaces with an agent on each; its state is read from their files."""

    kinds = {"kill": 0.35, "volley": 0.1, "freeze": 0.2, "nap": 0.15, "partition": 0.2}

    def __init__(self, folder: Path, graph: Path) -> None:
        self._world = World(folder, graph)
        self._plan = self._world.plan
        self.hosts = self._plan.hosts
        self.names = tuple(dict.fromkeys(f"{n.host}/{n.process}" for n in self._plan.nodes))
        self._ended = False
        self._ledgers: dict[str, Ledger] = {}
        self._runs: dict[str, str] = {}

    def __enter__(self) -> "ThreeHosts":
        self._world.__enter__()
        try:
            self._world.up()
            self._open()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _open(self) -> None:
        for host in self.hosts:
            self._runs[host] = str(self._noted(host)["run"])
            folder = path_of(self._runs[host], self._memory_folder(host))
            self._ledgers[host] = Ledger.open(PrivateFolder(folder))

    def __exit__(self, *caught: Any) -> None:
        if not self._ended:
            self._ended = True
            self._world.__exit__(*caught)

    @property
    def commands(self) -> Histogram:
        """The histogram of the source, on its host."""
        source = next(sources(self._plan))
        return self._ledgers[source.host].nodes[source.index].histograms["loop"]

    def accounts(self, victim: str) -> list[NodeAccount]:
        """Return the accounts of the nodes of `host/process`, or of a host."""
        host, _, process = victim.partition("/")
        nodes = [n for n in self._plan.nodes if n.host == host and process in ("", n.process)]
        return [self._ledgers[host].nodes[n.index] for n in nodes]

    def pid(self, name: str) -> int:
        """Return the process id in the host's run file, 0 while there is none."""
        host, _, process = name.partition("/")
        return int(self._noted(host)["pids"].get(process, 0))

    def restarts(self) -> int:
        """Return the sum of all epochs, which rises with every new instance."""
        return sum(self._ledgers[n.host].nodes[n.index].epoch for n in self._plan.nodes)

    def link(self, host: str, *, up: bool) -> None:
        """Set the link of the host's namespace."""
        self._world.link(host, up=up)

    def look(self) -> None:
        """Wait for a moment; the agents supervise the graph."""
        time.sleep(LOOK_S)
        ended = [host for host, agent in self._world.agents.items() if agent.poll() is not None]
        self.failure = f"the agent of {ended[0]} ended" if ended else ""

    def end(self) -> dict[str, Any]:
        """Check the accounts, take the graph down and end the agents."""
        time.sleep(SETTLE_S)
        edges = [self._report(edge.index) for edge in self._plan.edges]
        loop = {"latency_ms": self.commands.summary()}
        self._world.fovea("down", self._plan.name)
        left = [name for host in self.hosts for name in self._memory(host)]  # gone with the agent
        self.__exit__()
        left += [name for host in self.hosts for name in leftover_files(self._world.home(host))]
        listed = [(p.pid, p.info["cmdline"] or []) for p in psutil.process_iter(["cmdline"])]
        runs = set(self._runs.values())
        return {
            "unbalanced": self._unsettled(edges),
            "orphans": [pid for pid, words in listed if runs & set(words)],
            "left": sorted(left), "loop": loop, "edges": edges,
        }  # fmt: skip

    def _report(self, index: int) -> dict[str, Any]:
        edge = self._plan.edges[index]
        account = self._ledgers[self._plan.node(edge.target).host].edges[index]
        return {"from": edge.origin, "to": edge.end, "depth": edge.depth, **account.report()}

    def _unsettled(self, edges: Sequence[Mapping[str, Any]]) -> list[str]:
        """Return the unbalanced edges of a running graph; few messages may be in flight."""
        fair = [min(e["in_flight"], e["depth"] + 1) for e in edges]
        return unbalanced(
            [
                {**e, "offered": e["offered"] - n, "in_flight": e["in_flight"] - n}
                for e, n in zip(edges, fair, strict=True)
            ]
        )

    def _memory_folder(self, host: str) -> Path:
        """Return the host's own folder of shared memory, as its agent sees it."""
        root = Path(f"/proc/{self._world.agents[host].pid}/root")
        return root / MEMORY.relative_to("/")

    def _memory(self, host: str) -> list[str]:
        return [f"{host}: {path.name}" for path in self._memory_folder(host).iterdir()]

    def _noted(self, host: str) -> dict[str, Any]:
        (path,) = self._world.home(host).glob(f"fovea-*/{self._plan.name}@{host}/run.json")
        found: dict[str, Any] = json.loads(path.read_text())
        return found
