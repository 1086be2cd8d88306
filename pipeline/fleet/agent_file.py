"""Configuration file of an agent, and the folder in which it stores the running graphs.

The file sets the host's label and address, the users and hosts it accepts and the operators it may
run. From the folder, graphs resume after a restart.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from pipeline import settings as checked
from pipeline.bus.network import LOCAL, NODE_PORTS
from pipeline.errors import GraphError, MessageError, RunError, SettingsError
from pipeline.fleet.names import ROUTED, check_user, endpoint, host_identity, user_identity
from pipeline.fleet.placement import ANY, Allowed, is_digest
from pipeline.fleet.secure import Credentials
from pipeline.graph.yaml_lines import YamlFile, plain
from pipeline.naming import check_name
from pipeline.protocol.codec import MOST_BYTES, Kind, decode, encode
from pipeline.protocol.fleet import Start
from pipeline.run.rundir import base
from pipeline.whole_file import write_whole

# it has end points and fingerprints beside a plan that came in a message of at most `MOST_BYTES`
STORED: Kind[Start] = Kind("a Start", Start, 2 * MOST_BYTES)


@dataclass(frozen=True, kw_only=True)
class AgentFile:
    """The configuration of a host."""

    FORMER: ClassVar[Mapping[str, str]] = {
        "boxes": "renamed; expected hosts",
        "papers": "renamed; expected credentials",
        "people": "renamed; expected users",
    }
    label: str
    address: str = ""  # HOST[:PORT], requires credentials; empty: a unix socket of this user
    router: str = ""  # HOST[:PORT] where it meets the others, in place of an address
    credentials: str = ""  # folder made by `fovea secure`, relative to this file
    ports: tuple[int, int] = NODE_PORTS  # port range of nodes with an edge to another host
    users: tuple[str, ...] = ()  # names of those who may deploy
    hosts: tuple[str, ...] = ()  # labels of the hosts that may share a graph with it
    operators: dict[str, str] = field(default_factory=dict)  # module:Class -> sha256 or `any`
    weights: dict[str, str] = field(default_factory=dict)  # sha256 -> file; empty: may be sent
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)  # override the graph's
    state: str = ""  # folder of running graphs; empty: beside the run folders

    def __post_init__(self) -> None:
        check_name(self.label, "label", SettingsError)
        for other in self.hosts:
            check_name(other, "hosts", SettingsError)
        for name in self.users:
            check_user(name, "users")
        if self.address and not self.credentials and not self.address.startswith(LOCAL):
            raise SettingsError(
                f"address: {self.address}: a network address needs `credentials`, see "
                "`fovea secure`"
            )
        if self.router and self.address:
            raise SettingsError("router: expected no address beside it, got one")
        if self.router and not self.credentials:
            raise SettingsError(f"router: {self.router}: needs `credentials`, see `fovea secure`")
        if self.credentials and not (self.address or self.router):
            raise SettingsError("address: expected HOST[:PORT] beside credentials, got nothing")
        first, last = self.ports
        if not 0 < first <= last < 65536:
            raise SettingsError(f"ports: expected first and last of 1..65535, got {first}, {last}")
        for path, digest in self.operators.items():
            if digest != ANY and not is_digest(digest):
                raise SettingsError(f"operators.{path}: expected a sha256 or {ANY}, got {digest!r}")
        for digest in self.weights:
            if not is_digest(digest):
                raise SettingsError(f"weights.{digest}: expected a sha256")


@dataclass(frozen=True)
class HostConfig:
    """The configuration with its folder, against which paths are resolved."""

    file: AgentFile
    folder: Path
    any_operator: bool = False  # for an agent without a file, which only this user can reach

    @property
    def label(self) -> str:
        """The label of the host in graphs."""
        return self.file.label

    @property
    def credentials(self) -> Credentials | None:
        """The host's credentials; raises `SettingsError` when they are of another identity."""
        if not self.file.credentials:
            return None
        credentials = Credentials.of(self.folder / self.file.credentials)
        if credentials.identity != host_identity(self.label):
            raise SettingsError(
                f"{credentials.certificate}: expected the credentials of "
                f"{host_identity(self.label)}, got those of {credentials.identity}"
            )
        return credentials

    @property
    def endpoint(self) -> str:
        """The end point of the agent: where it listens, or that of its router."""
        if self.router:
            return self.router
        if self.file.address:
            return endpoint(self.file.address, "address")
        return local_endpoint(self.label)

    @property
    def router(self) -> str:
        """The end point of an agent behind its router; empty for one that listens."""
        return endpoint(f"{ROUTED}{self.file.router}", "router") if self.file.router else ""

    @property
    def state(self) -> Path:
        """The folder of running graphs."""
        if self.file.state:
            return self.folder / self.file.state
        return base() / f"agent-{self.label}"

    @property
    def identities(self) -> tuple[str, ...]:
        """The identities that may contact it."""
        return (*map(user_identity, self.file.users), *map(host_identity, self.file.hosts))

    @property
    def allowed(self) -> Allowed:
        """The allow lists of the host."""
        files = {d: self.folder / f if f else None for d, f in self.file.weights.items()}
        code = None if self.any_operator else self.file.operators
        return Allowed(code, files, self.state / "weights")


def read(path: Path) -> HostConfig:
    """Read an agent's file; raises `SettingsError` with file and line."""
    try:
        file = YamlFile(path)
    except GraphError as error:
        raise SettingsError(str(error)) from error
    document = plain(file.document)
    try:
        return HostConfig(checked.build(AgentFile, document, "agent"), path.resolve().parent)
    except checked.WrongSetting as error:
        said = str(error).removeprefix("agent.")
        raise SettingsError(f"{file.deepest(file.document, error.path)}: {said}") from error


def local_endpoint(label: str) -> str:
    """Return the unix socket of an agent without a network."""
    return f"{LOCAL}{base() / f'agent-{label}.sock'}"


class GraphStore:
    """A folder with two files per graph: the start request, and the number of starts."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """Return the graphs that ran when this agent ended."""
        return sorted(path.stem for path in self._folder.glob("*.graph"))

    def keep(self, graph: str, asked: Start) -> None:
        """Store the start request; raises `RunError` when it cannot be written or is too long."""
        path, data = self._folder / f"{graph}.graph", encode(asked)
        if len(data) > STORED.most_bytes:
            raise RunError(
                f"{path}: expected up to {STORED.most_bytes} bytes to store, got {len(data)}"
            )
        self._write(path, data)

    def asked(self, graph: str) -> Start:
        """Return the start request; raises `MessageError` for an invalid file."""
        path = self._folder / f"{graph}.graph"
        try:
            return decode(STORED, path.read_bytes())
        except (OSError, MessageError) as error:
            raise MessageError(f"{path}: not what an agent wrote: {error}") from error

    def count(self, graph: str) -> int:
        """Increment and return the number of starts of a graph; it never decreases."""
        path = self._folder / f"{graph}.starts"
        try:
            before = int(json.loads(path.read_text()))
        except FileNotFoundError:
            before = 0
        except (OSError, ValueError, TypeError) as error:
            raise RunError(
                f"{path}: expected a number; remove it on every host: {error}"
            ) from error
        self._write(path, str(before + 1).encode())
        return before + 1

    def forget(self, graph: str) -> None:
        """Remove a graph that was taken down; its peers forget its counters, too."""
        for kind in ("graph", "starts"):
            (self._folder / f"{graph}.{kind}").unlink(missing_ok=True)

    def _write(self, path: Path, data: bytes) -> None:
        """Write atomically, even if the power fails."""
        try:
            write_whole(path, data, durable=True)
        except OSError as error:
            raise RunError(f"{path}: cannot be written: {error.strerror}") from error
