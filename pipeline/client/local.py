"""Client of a graph on this host: asks over its bus, reads figures from its ledger."""

import itertools
import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import psutil

from pipeline.bus.ledger import Ledger
from pipeline.bus.tap import Tap
from pipeline.class_cache import adapter
from pipeline.client import detached
from pipeline.client.advising import take_advice
from pipeline.client.described import Description
from pipeline.client.graph_client import (
    ORDER_S,
    Edit,
    GraphClient,
    Listener,
    Status,
    Stopped,
    output_of,
)
from pipeline.errors import Busy, GraphError, MessageError, RunError, SettingsError
from pipeline.graph.plan import Plan
from pipeline.node.wiring import key_of
from pipeline.protocol.codec import decode, decode_answer, encode
from pipeline.protocol.fleet import EdgeState, NodeState, Process, State
from pipeline.protocol.orders import (
    GRAPH,
    RESULT,
    Done,
    Order,
    PlanOrder,
    Refused,
    Result,
    StopOrder,
    SwapOrder,
    SwapResult,
    TopologyResult,
)
from pipeline.protocol.questions import HEALTH, Health, HealthQuestion, NodeQuestion
from pipeline.run.bus_client import ask_local, client_session
from pipeline.run.logs import log_lines
from pipeline.run.rundir import memory_of, running
from pipeline.text import harmless
from pipeline.user_modules import look_in

QUICK_S = 3.0  # for replies that need no handler; a frozen process sends none
STOP_S = 120.0  # in-flight messages arrive and operators close
LOOK_S = 0.05
D = TypeVar("D", SwapResult, TopologyResult)
log = logging.getLogger(__name__)
HERE = ""  # the label of a graph's only host


class LocalGraph(GraphClient):
    """A graph on this host, found by its name."""

    def __init__(self, name: str, facts: Mapping[str, Any]) -> None:
        """`facts`: the record of the run (`pipeline.run.rundir.running`)."""
        self.name, self._facts = name, facts
        self._ledger: Ledger | None = None

    @property
    def facts(self) -> Mapping[str, Any]:
        """Return the current record of the run; raises `RunError` when it has ended."""
        now = running().get(self.name)
        if now is None or now["run"] != self._facts["run"]:
            raise RunError(f"{self.name}: the graph has ended")
        self._facts = now
        return now

    def runs(self) -> bool:
        """Whether the run that was found still exists."""
        return bool(running().get(self.name, {}).get("run") == self._facts["run"])

    def nodes(self) -> tuple[str, ...]:
        """The names of the nodes on this host."""
        return tuple(node["name"] for node in self._facts["nodes"])

    def ask(self, node: str, question: NodeQuestion) -> bytes:
        """Return a node's reply; raises `RunError` for an unknown node or a timeout."""
        self.check_node(node)
        return ask_local(self.name, self._facts["graph"], node, question)

    def health(self) -> dict[str, Health | None]:
        """Return every node's health; None for one that does not answer."""
        key = partial(key_of, self._facts["graph"])
        wanted = {key(node, HEALTH): node for node in self.nodes()}
        with client_session(self.name, "health") as session:
            answers = session.ask_all(
                key("*", HEALTH), encode(HealthQuestion()), QUICK_S,
                lambda answers: wanted.keys() <= answers.keys(),
            )  # fmt: skip
        return {
            node: decode_answer(Health, answers[key]) if key in answers else None
            for key, node in wanted.items()
        }

    def status(self) -> Status:
        """Return the status that `ps` and `top` show."""
        facts = self.facts
        if self._ledger is None:
            self._ledger = Ledger.open(memory_of(dict(facts)))
        state = state_from(facts, self._ledger)
        return Status(
            graph=self.name, hosts={HERE: (state,)}, nodes=dict.fromkeys(self.nodes(), HERE)
        )

    def swap(self, order: SwapOrder) -> SwapResult:
        """Replace a node; raises `FoveaError`, also for settings that the others do not fit."""
        plan = adapter(Plan).validate_python(self.facts["plan"])
        take_advice(plan, order)
        result = of_kind(SwapResult, self.tell(order))
        self._tell_how_long(plan)
        return result

    def replan(self, edit: Edit) -> TopologyResult:
        """Apply an edit to the plan of the graph; raises `FoveaError`."""
        facts = self.facts
        wanted = edit(adapter(Plan).validate_python(facts["plan"]))
        order = PlanOrder(plan=wanted, revision=facts["revision"])
        result = of_kind(TopologyResult, self.tell(order))
        with suppress(RunError):  # it may have ended since
            self._facts = self.facts  # the graph wrote down its nodes before it answered
        self._tell_how_long(wanted)
        return result

    def _tell_how_long(self, plan: Plan) -> None:
        """Log that a change of a part of a deployed graph, made here, is not kept by its agent."""
        if plan.here:
            whole = self.name.partition("@")[0]
            log.warning(
                "%s: lasts until this part starts again; a change of %s where it was brought up "
                "is kept", self.name, whole,
            )  # fmt: skip

    def add(self, file: Path) -> TopologyResult:
        """Add the nodes of a file; operators are also searched for where the graph was started."""
        try:
            folder = psutil.Process(self._facts["pid"]).cwd()
        except psutil.Error:
            folder = ""
        if folder:
            look_in(folder)
        return super().add(file)

    def stop(self) -> Stopped:
        """Stop the graph as one Ctrl-C would, and wait; raises `RunError` after a timeout."""
        self.tell(StopOrder())
        late_s = time.monotonic() + STOP_S
        while self.runs():
            if time.monotonic() > late_s:
                raise RunError(f"{self.name}: still runs after {STOP_S:.0f} s; see `fovea ps`")
            time.sleep(LOOK_S)
        ended = detached.await_end(self.name, self._facts["run"])
        if ended is None:
            return Stopped(graph=self.name)
        return Stopped(graph=self.name, exit_status=ended.exit_status, report=ended.report)

    def logs(self, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
        """Yield the last lines of a node's log, then new ones if `follow`."""
        return log_lines(self.name, node, lines, follow=follow)

    def listen(self, output: str) -> Listener:
        """Return a tap on `node` or `node.output`; raises `RunError` for an unknown output."""
        return _BusTap(self, output)

    def tell(self, order: Order) -> Done:
        """Send an order to the graph and return its result.

        Log first if the process that would carry it out is stopped: it answers when it goes on.
        """
        pid = self._facts["pid"]
        with suppress(psutil.Error):  # it ends
            if psutil.Process(pid).status() == psutil.STATUS_STOPPED:
                log.warning(
                    "%s: waits for process %d, which runs it and is stopped: kill -CONT %d",
                    self.name, pid, pid,
                )  # fmt: skip
        with client_session(self.name, "order") as session:
            key = f"fovea/{self._facts['graph']}/{GRAPH}"
            answer = session.ask(key, _written(order), ORDER_S, self.runs)
        if answer is None and not self.runs():
            raise RunError(f"{self.name}: ended before that was done")
        if answer is None:
            raise RunError(f"{self.name}: no answer for {ORDER_S:.0f} s; see `fovea ps`")
        return judged(decode(RESULT, answer))


class _BusTap(Listener):
    """A tap over the graph's own bus."""

    def __init__(self, client: LocalGraph, output: str) -> None:
        self.graph, self.output, self._client = client.name, output, client
        self._node, port, schema = output_of(client, output)
        self._key = key_of(client._facts["graph"], self._node, port)
        self.tap, self._open = Tap(Description(schema)), ExitStack()

    def __enter__(self) -> "Listener":
        session = self._open.enter_context(client_session(self.graph, "tap"))
        self._open.callback(session.listen(self._key, self.tap.receive))
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def over(self) -> str:
        """Return why no more messages will come, as a sentence; empty while they may."""
        try:
            facts = self._client.facts
        except RunError as error:
            return str(error)
        if self._node not in [node["name"] for node in facts["nodes"]]:
            return f"{self.graph}: {self._node} was removed"
        return ""


def state_from(facts: Mapping[str, Any], ledger: Ledger) -> State:
    """Return the state of a local graph from its record and its ledger."""
    nodes = tuple(_node(node, ledger) for node in facts["nodes"])
    gone = {node["name"] for node in facts["nodes"] if node["process"] in facts["gone"]}
    waits = any(not node.opened for node in nodes if node.name not in gone)
    return State(
        graph=facts["graph"],
        label=HERE,
        at_ns=time.monotonic_ns(),
        phase="starting" if waits else "running",
        failure="",
        processes=tuple(_processes(facts)),
        nodes=nodes,
        edges=tuple(_edge(edge, ledger) for edge in facts["edges"]),
        hosts=(),
        network_bytes={},
    )


def judged(result: Result) -> Done:
    """Return the result of an order; raises the error of one that was refused."""
    if isinstance(result, Refused) and result.busy:
        raise Busy(result.reason)
    if isinstance(result, Refused):
        raise (RunError if result.rolled_back else GraphError)(result.reason)
    return result


def of_kind(kind: type[D], done: Done) -> D:
    """Return the result if it is of that type; raises `MessageError` otherwise."""
    if isinstance(done, kind):
        return done
    raise MessageError(f"expected a {kind.__name__}, got a {type(done).__name__}")


def _processes(facts: Mapping[str, Any]) -> Iterator[Process]:
    by_process = itertools.groupby(
        sorted(facts["nodes"], key=lambda node: str(node["process"])), lambda node: node["process"]
    )
    names = {process: tuple(node["name"] for node in nodes) for process, nodes in by_process}
    for process, nodes in names.items():
        pid, cpu_s, rss_mb = facts["pids"].get(process, 0), 0.0, 0.0
        try:
            if pid:
                seen = psutil.Process(pid)
                cpu_s, rss_mb = sum(seen.cpu_times()[:2]), seen.memory_info().rss / 1e6
        except psutil.Error:
            pid = 0
        yield Process(
            name=process, nodes=nodes, pid=pid, cpu_s=cpu_s, rss_mb=rss_mb,
            restarts=facts["restarts"].get(process, 0), crashes=facts["crashes"].get(process, 0),
        )  # fmt: skip


def _node(names: Mapping[str, Any], ledger: Ledger) -> NodeState:
    account = ledger.nodes[names["index"]]
    times = {name: h.summary() for name, h in account.histograms.items()}
    return NodeState(
        name=names["name"], condition=account.condition, epoch=account.epoch,
        handled=account.handled, last_seq=account.last_seq, handler_ms=times["handler"],
        hop_ms=times["hop"], loop_ms=times["loop"], provider=account.provider,
    )  # fmt: skip


def _edge(names: Mapping[str, Any], ledger: Ledger) -> EdgeState:
    account = ledger.edges[names["index"]]
    return EdgeState(
        origin=names["from"], end=names["to"], account=account.report(),
        age_ms=account.age.summary(), age_error_ms=0.0, broken=bool(account.broken),
        sent=account.sent,
    )  # fmt: skip


def _written(order: Order) -> bytes:
    try:
        return encode(order)
    except MessageError as error:
        raise SettingsError(f"not an order: {harmless(str(error))}") from error
