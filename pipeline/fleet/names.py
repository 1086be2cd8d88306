"""Names between hosts: labels, identities in certificates, keys and addresses."""

import re

from pipeline.bus.network import AGENT_PORT, LOCAL
from pipeline.errors import SettingsError
from pipeline.graph.plan import Node
from pipeline.naming import check_name

ANYBODY = "local"  # who asks over a unix socket that only this user can reach
MOST_LETTERS = 64  # of a common name: RFC 5280, ub-common-name
_USER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.@-]{0,62}")
_HOST = re.compile(r"(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.-]+?)(?::(\d{1,5}))?")


def host_identity(label: str) -> str:
    """The identity of the agent of a host."""
    return f"host.{label}"


def user_identity(name: str) -> str:
    """The identity of a user at a command line."""
    return f"user.{name}"


def node_identity(graph: str, node: Node) -> str:
    """The identity of the process of a node; raises `SettingsError` for names it cannot have.

    No name has a dot, so no two processes have the same identity.
    """
    names = check_name(graph, "name", SettingsError), check_name(node.process, "nodes")
    return ".".join(("node", *names))


def check_identity(identity: str) -> str:
    """A name that a certificate can bear; raises `SettingsError`."""
    if len(identity) > MOST_LETTERS:
        raise SettingsError(
            f"{identity}: expected a name of up to {MOST_LETTERS} characters, as certificates "
            f"have, got {len(identity)}; shorten what it is made of"
        )
    return identity


def agent_key(label: str, identity: str, verb: str) -> str:
    """The key at which the agent of a host hears one identity, and no other."""
    return f"fovea/@agent/{label}/{identity}/{verb}"


def check_user(name: str, where: str) -> str:
    """The name of somebody, as an e-mail address or a login has it; raises `SettingsError`."""
    if not _USER.fullmatch(name) or ".." in name:
        raise SettingsError(f"{where}: expected a name of letters, digits, - _ . @, got {name!r}")
    return name


def endpoint(address: str, where: str) -> str:
    """What Zenoh calls an address: `HOST[:PORT]` or a unix socket; raises `SettingsError`.

    >>> endpoint("10.0.0.1", "hosts"), endpoint("[::1]:9", "hosts")
    ('tls/10.0.0.1:7447', 'tls/[::1]:9')
    """
    if address.startswith(LOCAL):
        return address
    found = _HOST.fullmatch(address.removeprefix("tls/"))
    if found is None or int(found[2] or AGENT_PORT) > 65535:
        raise SettingsError(f"{where}: expected HOST[:PORT], got {address!r}")
    return f"tls/{found[1]}:{found[2] or AGENT_PORT}"


def endpoint_host(point: str) -> str:
    """The host of a TLS end point."""
    return point.removeprefix("tls/").rpartition(":")[0]
