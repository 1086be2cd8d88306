"""What a host admits: plans of its version that its lists allow, at addresses that are its own."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from pipeline.bus.network import Network
from pipeline.errors import RunError
from pipeline.fleet.agent_file import GraphStore, HostConfig
from pipeline.fleet.hosted_graph import HostedGraph, Inspected, identity_of
from pipeline.fleet.inspection import Inspector
from pipeline.fleet.links import (
    asker_permits,
    check_credentials,
    end_points,
    local_end_points,
    networks,
    own_end_points,
)
from pipeline.fleet.names import (
    ANYBODY,
    endpoint,
    endpoint_host,
    host_identity,
    is_routed,
    region_of,
)
from pipeline.fleet.placement import Allowed, partners, permitted
from pipeline.graph.plan import Plan
from pipeline.naming import check_name
from pipeline.protocol import fleet as wire
from pipeline.protocol.fleet import Prepare, Prepared, Start
from pipeline.run.reaper import Reaper

MOST_GRAPHS = 8


class Admission:
    """Checks what a host is asked to run. Nothing starts here."""

    def __init__(
        self, own: HostConfig, allowed: Allowed, inspector: Inspector, store: GraphStore,
        hosted: Mapping[str, HostedGraph], reaper: Reaper | None,
    ) -> None:  # fmt: skip
        """`hosted`: the graphs of the host by name, as they are at any time."""
        self._own, self._label, self._allowed = own, own.label, allowed
        self._inspector, self._store, self._hosted, self._reaper = inspector, store, hosted, reaper
        self._credentials = own.credentials
        self.identities = own.identities if self._credentials else (ANYBODY, *own.identities)

    def network(self, **more: Any) -> Network:
        """Return a network with the host's credentials."""
        credentials = str(self._credentials.folder) if self._credentials else ""
        region = region_of(host_identity(self._label)) if self._own.router else ""
        return Network(credentials=credentials, region=region, **more)

    def prepared(self, asked: Prepare) -> Prepared:
        """Return free end points for a plan, or the weights that are lacking; raises if it may not.

        The inspection of its operators begins.
        """
        check_versions(asked.versions)
        here = [node for node in asked.plan.nodes if node.host == self._label]
        lacking = dict.fromkeys(d for n in here for d in self._allowed.missing(n.settings))
        if lacking:
            return Prepared({}, tuple(lacking))
        self._check_free(asked.plan, replace=asked.replace)
        local = self._permitted(asked.plan)
        self._inspector.prepare(local, asked.fingerprints, self._allowed.files_of(local))
        return Prepared(self._free_end_points(local))

    def inspected(self, plan: Plan, fingerprints: Mapping[str, str]) -> Inspected:
        """Return what this host would run of a plan, after an inspection of its operators."""
        local = self._permitted(plan)
        return local, self._inspector.begin(local, fingerprints, self._allowed.files_of(local))

    def hosted_of(self, asked: Start) -> HostedGraph:
        """Return the requested graph, checked but not started; raises `FoveaError`."""
        check_versions(asked.versions)
        plan = asked.plan
        self._check_free(plan, replace=True)
        self._check_partners(plan, asked)
        local, ports = self.inspected(plan, asked.fingerprints)
        own = own_end_points(local, self._free_end_points(local), asked.endpoints)
        self._check_unused(local, own)
        others = sorted(partners(local)[self._label])
        points = {label: self._reached(label, asked.hosts[label]) for label in others}
        router = self._own.router
        return HostedGraph(
            plan=local,
            ports=ports,
            fingerprint=identity_of(asked),
            networks=networks(local, own, asked.endpoints, self._credentials, router),
            hosts=points,
            way=self.network(permits=asker_permits(host_identity(self._label), points)),
            begins=partial(self._store.count, local.name),
            reaper=self._reaper,
        )

    def _permitted(self, plan: Plan) -> Plan:
        local = permitted(plan, self._label, self._allowed, self._own.file.settings)
        check_credentials(local, self._credentials)
        return local

    def _check_free(self, plan: Plan, *, replace: bool) -> None:
        hosted = self._hosted.get(plan.name)
        if hosted is not None and hosted.alive and not replace:
            raise RunError(f"{plan.name}: runs already; take it down first, or use --replace")
        if hosted is None and len(self._hosted) >= MOST_GRAPHS:
            raise RunError(f"{plan.name}: expected up to {MOST_GRAPHS} graphs on a host, got more")

    def _check_partners(self, plan: Plan, asked: Start) -> None:
        for label, point in asked.hosts.items():
            check_name(label, "hosts")
            if self._credentials and host_identity(label) not in self.identities:
                raise RunError(f"{label} is not among the hosts that this one may contact")
            endpoint(point, "hosts")
        others = partners(plan).get(self._label, frozenset())
        if others - set(asked.hosts):
            raise RunError(f"{plan.name}: no address for host {min(others - set(asked.hosts))}")
        for point in asked.endpoints.values():
            endpoint(point, "endpoints")

    def _reached(self, label: str, address: str) -> str:
        """Return the end point of another host; behind a router it is this host's own router.

        Raises `RunError` unless both are behind a router or neither is.
        """
        point = endpoint(address, "hosts")
        if is_routed(point) != bool(self._own.router):
            here = self._label
            behind, other = (label, here) if is_routed(point) else (here, label)
            raise RunError(
                f"{behind} is behind a router and {other} is not: expected every host of a graph "
                "behind it, or none"
            )
        return self._own.router or point

    def _free_end_points(self, local: Plan) -> dict[str, str]:
        """Return free end points for local processes with edges to other hosts."""
        if self._own.router:  # its processes connect to it, and nothing listens here
            return {}
        if self._credentials is None:
            return local_end_points(local)
        first, last = self._own.file.ports
        used = self._used(local.name)
        return end_points(local, endpoint_host(self._own.endpoint), range(first, last + 1), used)

    def _used(self, but: str) -> set[str]:
        """Return the end points of the other graphs here."""
        others = [other for graph, other in list(self._hosted.items()) if graph != but]
        return {p for o in others for network in o.networks.values() for p in network.listen}

    def _check_unused(self, local: Plan, own: Mapping[str, str]) -> None:
        """Raise `RunError` for an end point that is not this host's, or already in use."""
        if self._credentials is None or self._own.router:
            return
        first, last = self._own.file.ports
        host = endpoint_host(self._own.endpoint)
        mine = {f"tls/{host}:{port}" for port in range(first, last + 1)} - self._used(local.name)
        if strange := sorted(set(own.values()) - mine):
            raise RunError(f"{local.name}: {strange[0]} is not free here any more, try again")


def check_versions(theirs: wire.Versions) -> None:
    """Raise `RunError` unless another host or desk has the versions of this one."""
    if theirs != (ours := wire.Versions.ours()):
        raise RunError(f"expected {theirs}, got {ours} here")
