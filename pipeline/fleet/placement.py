"""Placement of a graph's nodes on hosts, and the allow lists of a host.

Code and paths never come over the wire: a graph names operators that a host lists, by name and
checksum, and files only as `sha256:…` of weights that it lists too. Nothing here imports what a
plan names.
"""

import hashlib
import importlib.util
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.bus.clocks import MOST_HOSTS
from pipeline.bus.ledger import ROOM_EDGES, ROOM_NODES
from pipeline.bus.network import LARGEST_BYTES
from pipeline.errors import GraphError, SettingsError, WeightsError
from pipeline.fleet.names import node_identity
from pipeline.graph.plan import Node, Plan
from pipeline.whole_file import write_whole

ANY = "any"  # instead of a checksum: any installed version
DIGEST_PREFIX = "sha256:"
MOST_WEIGHTS_BYTES = LARGEST_BYTES - (1 << 20)  # they are sent as one message
DEEPEST = 32  # nested levels of a setting's value
_NAME_OF_FILE = re.compile(r".*\.[^\W\d]\w{0,9}", re.DOTALL)  # has a file extension
_DIGEST = re.compile(r"[0-9a-f]{64}")


def validate_plan(plan: Plan, label: str) -> None:
    """Raise `FoveaError` for a plan that the loader would not produce."""
    if plan.clock != "realtime":
        raise GraphError(f"{plan.name}: clock: expected realtime between hosts, got {plan.clock}")
    if not plan.nodes:
        raise GraphError(f"{plan.name}: expected nodes, got none")
    if len(plan.hosts) > MOST_HOSTS or label not in plan.hosts or plan.here:
        raise GraphError(f"{plan.name}: hosts: expected {label} among them, got {plan.hosts}")
    hosts: dict[str, str] = {}
    check_numbered(plan)
    for node in plan.nodes:
        if node.host not in plan.hosts:
            raise GraphError(f"{node.name}: expected a node with a place of its own")
        if hosts.setdefault(node.process, node.host) != node.host:
            raise GraphError(f"{node.name}: expected the host of its group, got {node.host}")
    for edge in plan.edges:
        if edge.command and edge.keep != "latest":
            raise GraphError(f"{edge.end}: expected latest for a command, got {edge.keep}")


def check_numbered(plan: Plan) -> None:
    """Raise `GraphError` unless every node and edge has a unique index in the ledger.

    After removals, there may be gaps.
    """
    for kind, found, room in (
        ("a node", [(n.index, n.name) for n in plan.nodes], ROOM_NODES),
        ("an edge", [(e.index, e.end) for e in plan.edges], ROOM_EDGES),
    ):
        taken: set[int] = set()
        for index, name in found:
            if index in taken or not 0 <= index < len(found) + room:
                raise GraphError(f"{name}: expected {kind} with a place of its own")
            taken.add(index)


@dataclass(frozen=True)
class Allowed:
    """The allow lists of one host."""

    code: Mapping[str, str] | None  # module:Class -> sha256 of its files, or `any`; None: any class
    weights: Mapping[str, Path | None]  # sha256 -> file; None: may be sent
    store: Path  # folder of received weights

    def check_code(self, path: str, where: str) -> None:
        """Raise `SettingsError` unless the class is allowed in its installed version."""
        if self.code is None:
            return
        if path not in self.code:
            raise SettingsError(
                f"{where}: {path} is not on the allow list of this host, `operators` in its "
                "agent.yaml"
            )
        wanted = self.code[path]
        if wanted != ANY and (got := code_digest(path)) != wanted:
            raise SettingsError(
                f"{where}: {path}: expected code with sha256 {wanted[:12]}…, got {got[:12]}…"
            )

    def files_of(self, plan: Plan) -> dict[str, str]:
        """Return module -> file for the code of this host's nodes that is allowed by checksum."""
        files: dict[str, str] = {}
        for node in filter(plan.is_here, plan.nodes):
            for path in code_of(node.operator, node.settings):
                module = path.partition(":")[0]
                wanted = ANY if self.code is None else self.code.get(path, ANY)
                if wanted != ANY and (file := module_file(module)) is not None:
                    files[module] = str(file)
        return files

    def localise(self, value: Any, where: str, depth: int = 0) -> Any:
        """Return a setting's value with weights as local files; raises for forbidden values."""
        if depth > DEEPEST:
            raise SettingsError(f"{where[:60]}: expected no more than {DEEPEST} levels")
        if isinstance(value, Mapping):
            return {
                self.localise(k, where, depth + 1): self.localise(v, f"{where}.{k}", depth + 1)
                for k, v in value.items()
            }
        if isinstance(value, (list, tuple)):
            return [self.localise(v, where, depth + 1) for v in value]
        if not isinstance(value, str):
            return value
        if value.startswith(DIGEST_PREFIX):
            return str(self.file(value.removeprefix(DIGEST_PREFIX), where))
        if is_code(value):
            self.check_code(value, where)
        elif is_path(value):
            raise SettingsError(
                f"{where}: expected no path from outside, got {value!r}; set it in the agent's file"
            )
        return value

    def file(self, digest: str, where: str) -> Path:
        """Return the weights with that checksum; raises `SettingsError` if unavailable."""
        if digest not in self.weights:
            raise SettingsError(f"{where}: weights {digest[:12]}… are not on the allow list")
        path = self.weights[digest] or self.store / digest
        if not path.is_file():
            raise SettingsError(f"{where}: weights {digest[:12]}… are allowed, but not there yet")
        if (got := file_digest(path)) != digest:
            raise SettingsError(f"{where}: {path}: expected sha256 {digest[:12]}…, got {got[:12]}…")
        return path

    def missing(self, value: Any) -> tuple[str, ...]:
        """Return the weights in a setting's value that are allowed but not present."""
        found = strings(value, lambda text: text.startswith(DIGEST_PREFIX))
        digests = {text.removeprefix(DIGEST_PREFIX) for text in found}
        known = {d: self.weights[d] or self.store / d for d in digests if d in self.weights}
        return tuple(sorted(d for d, path in known.items() if not path.is_file()))

    def keep(self, data: bytes) -> str:
        """Store received weights; raises `WeightsError` when they are not allowed."""
        digest = hashlib.sha256(data).hexdigest()
        if digest not in self.weights or len(data) > MOST_WEIGHTS_BYTES:
            raise WeightsError(f"weights {digest[:12]}… are not on the allow list")
        self.store.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(self.store / digest, data)
        return digest


def is_path(value: str) -> bool:
    """Whether a string has the form of a file name, existing or not.

    >>> [is_path(text) for text in ("ball", "1.5", "look.rrd", "../x", "main referee")]
    [False, False, True, True, False]
    """
    if any(mark in value for mark in "/\\\0") or value.startswith((".", "~")):
        return True
    return bool(_NAME_OF_FILE.fullmatch(value))


def is_code(value: str) -> bool:
    """Whether a string could be an import path; times and the like must not look like one."""
    return ":" in value and not value.startswith(DIGEST_PREFIX)


def strings(value: Any, wanted: Callable[[str], bool]) -> list[str]:
    """Return all strings in a value that satisfy a predicate."""
    if isinstance(value, Mapping):
        return [s for v in value.values() for s in strings(v, wanted)]
    if isinstance(value, (list, tuple)):
        return [s for v in value for s in strings(v, wanted)]
    return [value] if isinstance(value, str) and wanted(value) else []


def code_of(operator: str, settings: Any) -> list[str]:
    """Return the classes that a node names: its operator, and those in its settings."""
    return [operator, *strings(settings, is_code)]


def code_digest(path: str) -> str:
    """Return the sha256 of the files of a class's module or package; raises `SettingsError`."""
    origin = module_file(path)
    if origin is None:
        raise SettingsError(f"{path}: not installed here")
    files = sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.relative_to(origin.parent).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def file_digest(path: Path) -> str:
    """Return the sha256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_digest(text: str) -> bool:
    """Whether a text has the form of a sha256."""
    return bool(_DIGEST.fullmatch(text))


def plan_for(plan: Plan, label: str) -> Plan:
    """Return the plan as a host runs it: edges to other hosts send complete messages."""
    local = replace(plan, here=label)
    edges = tuple(replace(e, transport="bytes") if local.crosses(e) else e for e in plan.edges)
    return replace(local, edges=edges)


def check_labels(plan: Plan, labels: Mapping[str, Any]) -> None:
    """Raise `GraphError` unless every label has a host and the clock is realtime."""
    if plan.clock == "lockstep":
        raise GraphError(f"{plan.name}: lockstep runs on one host, got several")
    used = {node.host for node in plan.nodes}
    if used == {""}:
        raise GraphError(f"{plan.name}: expected a `host` label at every node, got none")
    for label in sorted(used):
        if label not in labels:
            raise GraphError(
                f"{plan.name}: no host {label} among the known agents"
                f"{checked.suggest(label, labels)}"
            )


def borders(plan: Plan) -> dict[str, frozenset[str]]:
    """Return the processes with edges to other hosts, as `label/process`, and their partners."""
    found: dict[str, set[str]] = {}
    for edge in plan.edges:
        source, target = plan.node(edge.source), plan.node(edge.target)
        if source.host != target.host:
            found.setdefault(place(source), set()).add(place(target))
            found.setdefault(place(target), set()).add(place(source))
    return {name: frozenset(others) for name, others in found.items()}


def partners(plan: Plan) -> dict[str, frozenset[str]]:
    """Return, for each host, those whose clock, readiness and accounts concern it.

    They share an edge with it, or exposures of the one reach the other: their times are in the
    clock of the host that exposed. Commands carry such times too, but what a source sends is new.
    """
    hosts = {node.name: node.host for node in plan.nodes}
    sources = {name for name in hosts if plan.exposes(name)}
    readers: dict[str, set[str]] = {name: set() for name in hosts}
    for edge in plan.edges:
        readers[edge.source].add(edge.target)
    found: dict[str, set[str]] = {label: set() for label in hosts.values()}
    for origin, known in readers.items():
        reached, waiting = set(known), list(known) if origin in sources else []
        while waiting:
            name = waiting.pop()
            new = set() if name in sources else readers[name] - reached
            reached |= new
            waiting += new
        for there in {hosts[name] for name in reached} - {hosts[origin]}:
            found[hosts[origin]].add(there)
            found[there].add(hosts[origin])
    return {label: frozenset(others) for label, others in found.items()}


def place(node: Node) -> str:
    """Return `label/process`."""
    return f"{node.host}/{node.process}"


def identities(plan: Plan, label: str) -> list[str]:
    """Return the nodes of a host that need credentials: those with an edge to another host."""
    crossing = borders(plan)
    here = [node for node in plan.nodes if node.host == label and place(node) in crossing]
    return list(dict.fromkeys(node_identity(plan.name, node) for node in here))


def listeners(plan: Plan, label: str) -> list[str]:
    """Return the listening processes of a host: of two connected ones, the first by name."""
    found = borders(plan)
    return [
        name.partition("/")[2]
        for name, others in found.items()
        if name.partition("/")[0] == label and any(name < other for other in others)
    ]


def permitted(plan: Plan, label: str, allowed: Allowed, over: Mapping[str, Any]) -> Plan:
    """The plan that a host would run, with its own settings; raises for what may not run.

    Nothing is imported: whether operators and settings fit is `inspection`'s to say.
    """
    validate_plan(plan, label)
    nodes = []
    for node in plan.nodes:
        if node.host == label:
            node = replace(node, settings=_settings(node, allowed, over.get(node.name, {})))
        nodes.append(node)
    local = plan_for(replace(plan, nodes=tuple(nodes)), label)
    local.order()
    return local


def _settings(node: Node, allowed: Allowed, own: Mapping[str, Any]) -> dict[str, Any]:
    allowed.check_code(node.operator, f"{node.name}.operator")
    foreign = {k: v for k, v in node.settings.items() if k not in own}
    return {**allowed.localise(foreign, node.name), **own}


def module_file(path: str) -> Path | None:
    """Return where the module of an import path lies, without importing it; None: nowhere here."""
    first, *rest = path.partition(":")[0].split(".")
    try:
        spec = importlib.util.find_spec(first)
    except (ImportError, ValueError):
        return None
    for part in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        # by its last name alone: with the dotted one a namespace package looks for imported ones
        spec = PathFinder.find_spec(part, list(spec.submodule_search_locations))
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None
