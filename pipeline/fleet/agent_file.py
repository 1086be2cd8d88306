"""The file an agent reads, and the folder in which it notes which graphs run.

The file says who the host is, where it listens, who may ask it and what may run there; by the
folder graphs resume after a restart.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from pipeline import settings as checked
from pipeline.bus.network import LOCAL, NODE_PORTS
from pipeline.errors import GraphError, MessageError, RunError, SettingsError
from pipeline.fleet.names import check_user, endpoint, host_identity, user_identity
from pipeline.fleet.placement import ANY, Allowed, is_digest
from pipeline.fleet.secure import Credentials
from pipeline.graph.yaml_lines import YamlFile, plain
from pipeline.naming import check_name
from pipeline.protocol.codec import decode, encode
from pipeline.protocol.fleet import Start
from pipeline.run.rundir import base
from pipeline.whole_file import write_whole


@dataclass(frozen=True, kw_only=True)
class AgentFile:
    """What a host is and allows."""

    FORMER: ClassVar[Mapping[str, str]] = {
        "boxes": "renamed; expected hosts",
        "papers": "renamed; expected credentials",
        "people": "renamed; expected users",
    }
    label: str
    address: str = ""  # HOST[:PORT] with credentials; empty: a unix socket of this user
    credentials: str = ""  # folder by `fovea secure`, relative to this file
    ports: tuple[int, int] = NODE_PORTS  # first and last, of nodes with an edge to another host
    users: tuple[str, ...] = ()  # who may deploy, by name
    hosts: tuple[str, ...] = ()  # labels of the hosts that may share a graph with it
    operators: dict[str, str] = field(default_factory=dict)  # module:Class -> sha256 or `any`
    weights: dict[str, str] = field(default_factory=dict)  # sha256 -> file, or empty: may be sent
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)  # of nodes, laid over
    state: str = ""  # folder of what runs here; empty: beside the run folders

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
        if self.credentials and not self.address:
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
    """The file together with where it lies: every path resolved."""

    file: AgentFile
    folder: Path
    any_operator: bool = False  # of an agent without a file, which only this user reaches

    @property
    def label(self) -> str:
        """The label that graphs name."""
        return self.file.label

    @property
    def credentials(self) -> Credentials | None:
        """Its credentials; raises `SettingsError` when they are another's."""
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
        """Where the agent listens."""
        if self.file.address:
            return endpoint(self.file.address, "address")
        return local_endpoint(self.label)

    @property
    def state(self) -> Path:
        """The folder of what runs here."""
        if self.file.state:
            return self.folder / self.file.state
        return base() / f"agent-{self.label}"

    @property
    def identities(self) -> tuple[str, ...]:
        """Who may speak with it."""
        return (*map(user_identity, self.file.users), *map(host_identity, self.file.hosts))

    @property
    def allowed(self) -> Allowed:
        """Its allow lists."""
        files = {d: self.folder / f if f else None for d, f in self.file.weights.items()}
        code = None if self.any_operator else self.file.operators
        return Allowed(code, files, self.state / "weights")


def read(path: Path) -> HostConfig:
    """An agent's file; raises `SettingsError` with file and line."""
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
    """The unix socket of an agent without a network."""
    return f"{LOCAL}{base() / f'agent-{label}.sock'}"


class GraphStore:
    """A folder with two files per graph: what was asked, and how often it began."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """The graphs that ran when this host ended."""
        return sorted(path.stem for path in self._folder.glob("*.graph"))

    def keep(self, graph: str, asked: Start) -> None:
        """Note what was asked; raises `RunError` when that cannot be."""
        self._write(self._folder / f"{graph}.graph", encode(asked))

    def asked(self, graph: str) -> Start:
        """What was asked; raises `MessageError` for a file that does not say."""
        path = self._folder / f"{graph}.graph"
        try:
            return decode(Start, path.read_bytes())
        except (OSError, MessageError) as error:
            raise MessageError(f"{path}: not what an agent wrote: {error}") from error

    def count(self, graph: str) -> int:
        """One more start of a graph: how many there were. It never counts back."""
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
        """It is taken down; others that know its numbers are, too."""
        for kind in ("graph", "starts"):
            (self._folder / f"{graph}.{kind}").unlink(missing_ok=True)

    def _write(self, path: Path, data: bytes) -> None:
        """All of it or nothing, also when the power fails."""
        try:
            write_whole(path, data, durable=True)
        except OSError as error:
            raise RunError(f"{path}: cannot be written: {error.strerror}") from error
