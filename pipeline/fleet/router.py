"""`fovea router`: the meeting point of hosts that cannot reach one another.

It carries what its access list names and nothing else. The list says per identity what may pass, as
certificates prove who is at the other end of each link; the hosts themselves see only the router.
"""

import json
import logging
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline import settings as checked
from pipeline.bus.network import Deed, Network, Permit
from pipeline.bus.outport import BYTES_SUFFIX
from pipeline.bus.session import Session
from pipeline.errors import GraphError, SettingsError
from pipeline.fleet.links import TIMEOUT_MS
from pipeline.fleet.names import (
    ROUTER,
    agent_key,
    check_identity,
    check_user,
    endpoint,
    host_identity,
    node_identity,
    region_of,
    user_identity,
)
from pipeline.fleet.secure import Credentials
from pipeline.graph.plan import Plan
from pipeline.graph.yaml_lines import YamlFile, plain
from pipeline.naming import check_name
from pipeline.node.wiring import key_of

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Route:
    """The identities of the processes at an edge between hosts."""

    writer: str
    readers: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RouterFile:
    """The configuration of a router: `router.yaml`, made by `fovea secure`."""

    address: str  # HOST[:PORT] at which it listens
    credentials: str = "."  # folder made by `fovea secure`, relative to the file
    users: tuple[str, ...] = ()  # may ask the agents of all hosts here
    hosts: tuple[str, ...] = ()  # labels; their agents answer users and ask one another
    edges: dict[str, Route] = field(default_factory=dict)  # by graph.node.output

    def __post_init__(self) -> None:
        endpoint(self.address, "address")
        for name in self.users:
            check_user(name, "users")
        for label in self.hosts:
            check_name(label, "hosts", SettingsError)
        for output, route in self.edges.items():
            if output.count(".") != 2:
                raise SettingsError(f"edges: expected graph.node.output, got {output!r}")
            for part in output.split("."):
                check_name(part, f"edges.{output}", SettingsError)
            for identity in (route.writer, *route.readers):
                kind, _, rest = check_identity(identity).partition(".")
                if kind != "node":
                    raise SettingsError(
                        f"edges.{output}: expected node.GRAPH.PROCESS, got {identity!r}"
                    )
                for part in rest.split("."):
                    check_name(part, f"edges.{output}", SettingsError)
        if not self.identities:
            raise SettingsError("hosts: expected those that meet here, got none")

    @property
    def identities(self) -> tuple[str, ...]:
        """All identities that may connect."""
        nodes = [i for route in self.edges.values() for i in (route.writer, *route.readers)]
        known = (*map(user_identity, self.users), *map(host_identity, self.hosts), *nodes)
        return tuple(dict.fromkeys(known))


def read_router(path: Path) -> RouterFile:
    """Read a router's file; raises `SettingsError` with file and line."""
    try:
        file = YamlFile(path)
    except GraphError as error:
        raise SettingsError(str(error)) from error
    try:
        return checked.build(RouterFile, plain(file.document), "router")
    except checked.WrongSetting as error:
        said = str(error).removeprefix("router.")
        raise SettingsError(f"{file.deepest(file.document, error.path)}: {said}") from error
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


def permits_of(file: RouterFile) -> tuple[Permit, ...]:
    """Return what each identity may send to the router, and what it may get from it.

    An agent serves its own keys, an asker asks under its own; only where both agree something
    passes.
    """
    answers: tuple[Deed, ...] = ("reply", "declare_queryable", "declare_subscriber")
    askers = (*map(user_identity, file.users), *map(host_identity, file.hosts))
    found = [
        *(
            Permit(
                identity=asker, key=agent_key("*", asker, "**"),
                inward=("query", "put"), outward=answers,
            )
            for asker in askers
        ),
        *(
            Permit(
                identity=host_identity(label), key=agent_key(label, "*", "**"),
                inward=answers, outward=("query", "put"),
            )
            for label in file.hosts
        ),
    ]  # fmt: skip
    for output, route in file.edges.items():
        graph, node, name = output.split(".")
        key = key_of(graph, node, name) + BYTES_SUFFIX
        found.append(
            Permit(identity=route.writer, key=key, inward=("put",), outward=("declare_subscriber",))
        )
        found += [
            Permit(identity=reader, key=key, inward=("declare_subscriber",), outward=("put",))
            for reader in route.readers
        ]
    return tuple(found)


def network_of(file: RouterFile, folder: Path) -> Network:
    """Return the router's network; raises `SettingsError` for credentials of another identity."""
    credentials = Credentials.of(folder / file.credentials)
    if credentials.identity != ROUTER:
        raise SettingsError(
            f"{credentials.certificate}: expected the credentials of {ROUTER}, got those of "
            f"{credentials.identity}"
        )
    return Network(
        listen=(endpoint(file.address, "address"),),
        credentials=str(credentials.folder),
        permits=permits_of(file),
        routes=tuple(map(region_of, file.identities)),
        timeout_ms=TIMEOUT_MS,  # it cannot know which edges are lossless
    )


class Router:
    """A router that runs. Use it as a context."""

    def __init__(self, path: Path) -> None:
        self._file = read_router(path)
        network = network_of(self._file, path.resolve().parent)
        self._where, self._stop = network.listen[0], threading.Event()
        self._session = Session.across(network)

    def __enter__(self) -> "Router":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def stop(self) -> None:
        """Make `run` return."""
        self._stop.set()

    def run(self) -> None:
        """Carry messages until stopped."""
        file = self._file
        log.info(
            "router listens at %s for %d hosts, %d users and the outputs of %d nodes",
            self._where, len(file.hosts), len(file.users), len(file.edges),
        )  # fmt: skip
        self._stop.wait()


def routes_of(plans: Iterable[Plan]) -> dict[str, Route]:
    """Return the edges between hosts of some graphs, by graph.node.output."""
    found: dict[str, Route] = {}
    for plan in plans:
        for edge in plan.edges:
            source, target = plan.node(edge.source), plan.node(edge.target)
            if source.host == target.host:
                continue
            output = f"{plan.name}.{edge.source}.{edge.output}"
            before = found[output].readers if output in found else ()
            readers = dict.fromkeys((*before, node_identity(plan.name, target)))
            found[output] = Route(writer=node_identity(plan.name, source), readers=tuple(readers))
    return found


def extended(
    path: Path, address: str, hosts: Sequence[str], users: Sequence[str], plans: Iterable[Plan]
) -> RouterFile:
    """Return the router's file at a path, or a new one, with more hosts, users and graphs.

    A graph that it knows already is replaced. Raises `SettingsError` for an invalid file.
    """
    plans = list(plans)
    before = read_router(path) if path.exists() else None
    if before is None:
        return RouterFile(
            address=address, users=tuple(users), hosts=tuple(hosts), edges=routes_of(plans)
        )
    names = {plan.name for plan in plans}
    kept = {o: r for o, r in before.edges.items() if o.partition(".")[0] not in names}
    return replace(
        before,
        users=tuple(dict.fromkeys((*before.users, *users))),
        hosts=tuple(dict.fromkeys((*before.hosts, *hosts))),
        edges={**kept, **routes_of(plans)},
    )


def router_yaml(file: RouterFile) -> str:
    """Return a router's file as text."""
    lines = [
        f"address: {json.dumps(file.address)} # where it listens",
        f"credentials: {json.dumps(file.credentials)}",
        f"users: {json.dumps(list(file.users))}",
        f"hosts: {json.dumps(list(file.hosts))}",
        f"edges: {'' if file.edges else '{} '}# graph.node.output: who writes it and who reads it",
        *(_route_line(output, route) for output, route in file.edges.items()),
    ]
    return "\n".join(lines) + "\n"


def _route_line(output: str, route: Route) -> str:
    said: Mapping[str, object] = {"writer": route.writer, "readers": list(route.readers)}
    return f"  {output}: {json.dumps(said)}"
