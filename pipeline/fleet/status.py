"""State of a host's part of a graph, as `ps` and `top` show it."""

import time

import psutil

from pipeline.bus.clocks import Clocks
from pipeline.fleet.hosted_graph import HostedGraph
from pipeline.fleet.peers import Peer
from pipeline.protocol.fleet import EdgeState, HostState, NodeState, Process, State
from pipeline.run.supervisor import Supervisor


def state_of(hosted: HostedGraph) -> State:
    """Return the current state of a hosted graph."""
    supervisor = hosted.supervisor
    return State(
        graph=hosted.plan.name,
        label=hosted.plan.here,
        at_ns=time.monotonic_ns(),
        phase=hosted.phase,
        failure=hosted.failure,
        processes=_processes(supervisor) if supervisor else (),
        nodes=_nodes(supervisor) if supervisor else (),
        edges=_edges(supervisor, hosted.clocks) if supervisor else (),
        hosts=tuple(_host(n) for n in hosted.peers.values()) if supervisor else (),
        network_bytes={
            name: (seen.bytes_recv, seen.bytes_sent)
            for name, seen in psutil.net_io_counters(pernic=True).items()
        },
    )


def _processes(supervisor: Supervisor) -> tuple[Process, ...]:
    found = []
    for name, managed in supervisor.processes.items():
        sample = managed.handle.sample() if managed.handle else None
        found.append(
            Process(
                name=name,
                nodes=tuple(n.name for n in managed.nodes),
                pid=supervisor.pid(name),
                cpu_s=sample.cpu_s if sample else 0.0,
                rss_mb=sample.rss_mb if sample else 0.0,
                restarts=supervisor.restarts.get(name, 0),
                crashes=supervisor.crashes.get(name, 0),
            )
        )
    return tuple(found)


def _nodes(supervisor: Supervisor) -> tuple[NodeState, ...]:
    found = []
    for node in filter(supervisor.plan.is_here, supervisor.plan.nodes):
        account = supervisor.ledger.nodes[node.index]
        times = {name: h.summary() for name, h in account.histograms.items()}
        found.append(
            NodeState(
                name=node.name,
                condition=account.condition,
                epoch=account.epoch,
                handled=account.handled,
                last_seq=account.last_seq,
                handler_ms=times["handler"],
                hop_ms=times["hop"],
                loop_ms=times["loop"],
                provider=account.provider,
            )
        )
    return tuple(found)


def _edges(supervisor: Supervisor, clocks: Clocks) -> tuple[EdgeState, ...]:
    plan, found = supervisor.plan, []
    sources = [n for n in plan.nodes if plan.exposes(n.name)]
    errors = [clocks.error_ns(node.host) for node in sources]
    for edge in plan.edges:
        if not plan.is_here(plan.node(edge.target)):
            continue
        account = supervisor.ledger.edges[edge.index]
        found.append(
            EdgeState(
                origin=edge.origin,
                end=edge.end,
                account=account.report(),
                age_ms=account.age.summary(),
                broken=bool(account.broken),
                sent=account.sent,
                age_error_ms=max((e or 0 for e in errors), default=0) / 1e6,
            )
        )
    return tuple(found)


def _host(peer: Peer) -> HostState:
    seen = peer.estimate
    return HostState(
        label=peer.label,
        lost=peer.lost,
        lost_for_s=time.monotonic() - peer.answered_s if peer.lost else 0.0,
        losses=peer.losses,
        clock_ahead_ms=seen.offset_ns / 1e6 if seen else 0.0,
        clock_error_ms=seen.error_ns / 1e6 if seen else 0.0,
        round_trip_ms=seen.round_trip_ns / 1e6 if seen else 0.0,
    )
