"""Create credentials and agent files for the hosts of graphs, to be copied there."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pipeline.errors import RunError, SettingsError
from pipeline.fleet import secure
from pipeline.fleet.hosts import known_addresses
from pipeline.fleet.names import (
    ROUTED,
    ROUTER,
    endpoint,
    host_identity,
    is_routed,
    user_identity,
)
from pipeline.fleet.placement import code_digest, code_of, file_digest, identities, is_path, strings
from pipeline.fleet.router import extended, router_yaml
from pipeline.graph.plan import Plan
from pipeline.settings import suggest
from pipeline.whole_file import write_whole


def issue_for(
    folder: Path, addresses: Mapping[str, str], plans: Sequence[Plan], users: Sequence[str]
) -> Iterator[str]:
    """Create missing credentials and files; yield a line for each.

    `addresses`: label -> address, which names a router for the hosts behind it (see `placed`).
    """
    labels = _labels(addresses, plans)
    for name in users:
        own = folder / user_identity(name)
        secure.issue(own, folder, user_identity(name))
        note = own / secure.ADDRESSES
        write_whole(
            note, json.dumps({**known_addresses(own), **{o: a for o, a in addresses.items() if a}})
        )
        yield f"{folder / user_identity(name)}: credentials of {name}, who may deploy"
    for label in labels:
        own = folder / host_identity(label)
        secure.issue(own, folder, host_identity(label))
        for plan in plans:
            for identity in identities(plan, label):
                secure.issue(own / "nodes" / identity, folder, identity)
        path = _agent_file(folder, label)
        if path.exists():
            yield f"{own}: credentials of host {label}; its agent.yaml stays as it was"
            continue
        others = [other for other in labels if other != label]
        write_whole(path, agent_yaml(label, addresses[label], users, others, plans))
        yield f"{own}: credentials and agent.yaml of host {label}, which allows what graphs need"
    routed = [label for label in labels if is_routed(addresses.get(label, ""))]
    if routed or _router_file(folder).exists():
        yield _issue_router(folder, {label: addresses[label] for label in routed}, plans, users)


def placed(
    folder: Path, addresses: Mapping[str, str], plans: Sequence[Plan], router: str
) -> dict[str, str]:
    """Return the addresses with that of the router for every new host without one.

    Raises `SettingsError` for an invalid address of the router.
    """
    if not router:
        return dict(addresses)
    point = endpoint(f"{ROUTED}{router}", "--router")
    new = [o for o in _labels(addresses, plans) if not _agent_file(folder, o).exists()]
    return {**addresses, **{label: point for label in new if not addresses.get(label)}}


def _issue_router(
    folder: Path, behind: Mapping[str, str], plans: Sequence[Plan], users: Sequence[str]
) -> str:
    """Create or extend the credentials and the file of the router; return a line."""
    path = _router_file(folder)
    address = next(iter(behind.values()), "").removeprefix(ROUTED)
    file = extended(path, address, list(behind), users, plans)
    secure.issue(path.parent, folder, ROUTER)
    write_whole(path, router_yaml(file))
    return (
        f"{path.parent}: credentials and router.yaml of the router, which carries what "
        f"{len(file.hosts)} hosts need; copy them there again when they change"
    )


def check_addressed(folder: Path, addresses: Mapping[str, str], plans: Sequence[Plan]) -> None:
    """Raise `RunError` for a new host without an address.

    Raises `SettingsError` for an invalid address, one that two hosts share, and, where graphs are
    given, for a new host that none of them has.
    """
    named = [host for plan in plans for host in plan.hosts]
    for label in addresses if plans else ():
        if label not in named and not _agent_file(folder, label).exists():
            raise SettingsError(f"--host {label}: no graph has it{suggest(label, named)}")
    taken: dict[str, str] = {}
    for label, address in {**_addresses_known(folder), **addresses}.items():
        if address and not is_routed(address):
            point = endpoint(address, f"--host {label}")
            if point in taken:
                raise SettingsError(
                    f"--host {label}={address}: expected an address or port of its own, got that "
                    f"of {taken[point]}"
                )
            taken[point] = label
    for label in _labels(addresses, plans):
        if not addresses.get(label) and not _agent_file(folder, label).exists():
            raise RunError(f"{label}: expected --host {label}=ADDRESS, got none")


def agent_yaml(
    label: str, address: str, users: Sequence[str], others: Sequence[str], plans: Sequence[Plan]
) -> str:
    """Return an agent's file that allows the graphs' nodes on that host, as installed here."""
    nodes = [node for plan in plans for node in plan.nodes if node.host == label]
    code = {
        path: code_digest(path) for node in nodes for path in code_of(node.operator, node.settings)
    }
    files = {
        Path(p) for node in nodes for p in strings(node.settings, is_path) if Path(p).is_file()
    }
    lines = [
        f"label: {label}",
        f"{'router' if is_routed(address) else 'address'}: "
        f"{json.dumps(address.removeprefix(ROUTED))}"
        if address
        else "",
        "credentials: ." if address else "",
        "state: state # what runs here and the weights it was sent, kept over a restart",
        f"users: {json.dumps(list(users))}",
        f"hosts: {json.dumps(list(others))}",
        "operators: # what may run here, each with the checksum of its files, or: any",
        *(f"  {path}: {digest}" for path, digest in sorted(code.items())),
        "weights: # checksum: file on this host, or empty where `fovea up` may send it",
        *(f'  {file_digest(file)}: "" # {file.name}' for file in sorted(files)),
    ]
    text = "\n".join(line for line in lines if line) + "\n"
    for name, known in (("operators", code), ("weights", files)):
        text = text if known else text.replace(f"{name}: #", f"{name}: {{}} #")
    return text


def _labels(addresses: Mapping[str, str], plans: Sequence[Plan]) -> list[str]:
    return list(dict.fromkeys([*addresses, *(host for plan in plans for host in plan.hosts)]))


def _addresses_known(folder: Path) -> dict[str, str]:
    """Return the addresses stored for the users of an authority: label -> address."""
    known: dict[str, str] = {}
    for note in sorted(folder.glob(f"*/{secure.ADDRESSES}")):
        known |= known_addresses(note.parent)
    return known


def _agent_file(folder: Path, label: str) -> Path:
    return folder / host_identity(label) / "agent.yaml"


def _router_file(folder: Path) -> Path:
    return folder / ROUTER / "router.yaml"
