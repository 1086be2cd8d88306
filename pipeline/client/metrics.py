"""Figures of running graphs for Prometheus: states of hosts -> metric families.

They are read when somebody asks, from what `fovea top` shows, so that a graph that nobody watches
pays nothing. Names and units are Prometheus' conventions: seconds, bytes, `_total` for counters.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from pipeline.client.graph_client import Status
from pipeline.errors import FoveaError
from pipeline.protocol.fleet import State

LEAST_INTERVAL_S = 0.5  # between two looks at the graphs, whoever asks
GRAPH = ("graph", "host")
NODE, PROCESS, EDGE = (*GRAPH, "node"), (*GRAPH, "process"), (*GRAPH, "from", "to")
PERCENTILES = {"p50": "50", "p99": "99"}
GAUGES = {  # name -> help, labels
    "fovea_graph_running": ("Whether a host's part of the graph runs.", GRAPH),
    "fovea_node_instance": ("Number of the node's instance; a swap or restart adds one.", NODE),
    "fovea_node_last_frame": ("Number of the last frame handled.", NODE),
    "fovea_node_condition": ("1 for the condition that the node is in.", (*NODE, "condition")),
    "fovea_node_provider": ("1 for what computes the node's networks.", (*NODE, "provider")),
    "fovea_node_handler_seconds": ("Time of a handler call.", (*NODE, "percentile")),
    "fovea_node_hop_seconds": ("Time from sending to the call.", (*NODE, "percentile")),
    "fovea_loop_seconds": ("Picture ready to sensor command.", (*NODE, "percentile")),
    "fovea_process_resident_memory_bytes": ("Memory of the process.", PROCESS),
    "fovea_edge_in_flight": ("Messages sent and not finished.", EDGE),
    "fovea_edge_age_seconds": ("Age of a message when it is used.", (*EDGE, "percentile")),
    "fovea_edge_broken": ("Whether a lossless reader lost messages.", EDGE),
    "fovea_host_lost": ("Whether another host of the graph does not answer.", (*GRAPH, "other")),
}
COUNTERS = {
    "fovea_node_messages_handled": ("Messages handled, of all instances.", NODE),
    "fovea_process_cpu_seconds": ("Time of a processor.", PROCESS),
    "fovea_process_restarts": ("Starts after the first.", PROCESS),
    "fovea_process_crashes": ("Unexpected ends.", PROCESS),
    "fovea_edge_messages_offered": ("Messages sent to this reader.", EDGE),
    "fovea_edge_messages_delivered": ("Messages that its handler took.", EDGE),
    "fovea_edge_messages_dropped": ("Messages dropped, by reason.", (*EDGE, "reason")),
    "fovea_edge_messages_lost_in_crash": ("Messages that a crash took along.", EDGE),
    "fovea_edge_messages_unexpected": ("Messages ignored: damaged, or sent twice.", EDGE),
}
Sample = tuple[str, Sequence[str], float]  # name, values of its labels, value


class GraphMetrics:
    """Answers scrapes; several at once share a look. Register it with a `CollectorRegistry`."""

    def __init__(self, look: Callable[[], Iterable[Status]]) -> None:
        self._look, self._lock = look, threading.Lock()
        self._looked_s, self._found = float("-inf"), list[Sample]()

    def describe(self) -> Iterable[Metric]:
        """Nothing: names are known without a look."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return all families, those without samples, too."""
        with self._lock:
            if time.monotonic() - self._looked_s >= LEAST_INTERVAL_S:
                self._found = []
                with suppress(FoveaError):  # the graph has ended, or is ending: no samples
                    self._found = [s for status in self._look() for s in samples(status)]
                self._looked_s = time.monotonic()
            found = self._found
        families: dict[str, Metric] = {
            name: GaugeMetricFamily(name, text, labels=labels)
            for name, (text, labels) in GAUGES.items()
        } | {
            name: CounterMetricFamily(name, text, labels=labels)
            for name, (text, labels) in COUNTERS.items()
        }
        for name, labels, value in found:
            families[name].add_metric(labels, value)  # type: ignore[attr-defined]
        return families.values()


def samples(status: Status) -> Iterator[Sample]:
    """Yield the figures of a graph, of every host that answers."""
    for label, said in status.hosts.items():
        if isinstance(said, str):
            yield "fovea_graph_running", (status.graph, label), 0.0
            continue
        for state in said:
            yield from _of_state(state, (status.graph, label))


def _of_state(state: State, at: tuple[str, str]) -> Iterator[Sample]:
    yield "fovea_graph_running", at, float(state.phase == "running")
    for process in state.processes:
        own = (*at, process.name)
        yield "fovea_process_cpu_seconds", own, process.cpu_s
        yield "fovea_process_resident_memory_bytes", own, process.rss_mb * 1e6
        yield "fovea_process_restarts", own, process.restarts
        yield "fovea_process_crashes", own, process.crashes
    for node in state.nodes:
        own = (*at, node.name)
        yield "fovea_node_messages_handled", own, node.handled
        yield "fovea_node_instance", own, node.epoch
        yield "fovea_node_last_frame", own, node.last_seq
        yield "fovea_node_condition", (*own, node.condition), 1.0
        if node.provider:
            yield "fovea_node_provider", (*own, node.provider), 1.0
        yield from _percentiles("fovea_node_handler_seconds", own, node.handler_ms)
        yield from _percentiles("fovea_node_hop_seconds", own, node.hop_ms)
        if node.loop_ms.get("p50"):  # of the node that commands the sensor
            yield from _percentiles("fovea_loop_seconds", own, node.loop_ms)
    for edge in state.edges:
        ends, account = (*at, edge.origin, edge.end), edge.account
        yield "fovea_edge_messages_offered", ends, account["offered"]
        yield "fovea_edge_messages_delivered", ends, account["delivered"]
        yield "fovea_edge_messages_lost_in_crash", ends, account["lost_in_crash"]
        yield "fovea_edge_messages_unexpected", ends, account.get("unexpected", 0)
        yield "fovea_edge_in_flight", ends, account["in_flight"]
        yield "fovea_edge_broken", ends, float(edge.broken)
        for reason, count in account["dropped"].items():
            yield "fovea_edge_messages_dropped", (*ends, reason), count
        yield from _percentiles("fovea_edge_age_seconds", ends, edge.age_ms)
    for other in state.hosts:
        yield "fovea_host_lost", (*at, other.label), float(other.lost)


def _percentiles(name: str, labels: Sequence[str], ms: dict[str, float]) -> Iterator[Sample]:
    for key, percentile in PERCENTILES.items():
        if key in ms:
            yield name, (*labels, percentile), ms[key] / 1e3
