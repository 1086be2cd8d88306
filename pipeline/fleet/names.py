"""Names in a deployment: labels, identities in certificates, keys and addresses.

The address of an agent behind a router is `router/HOST[:PORT]`, that of the router.
"""

import hashlib
import re

from pipeline.bus.network import AGENT_PORT, LOCAL
from pipeline.errors import SettingsError
from pipeline.graph.plan import Node
from pipeline.naming import check_name

ANYBODY = "local"  # identity of clients on a unix socket that only this user can reach
ROUTER = "router"  # identity of a router
ROUTED = "router/"  # begins the end point of an agent behind a router
MOST_LETTERS = 64  # of a common name (RFC 5280, ub-common-name)
_USER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.@-]{0,62}")
_HOST = re.compile(r"(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.-]+?)(?::(\d{1,5}))?")


def host_identity(label: str) -> str:
    """Return the identity of a host's agent."""
    return f"host.{label}"


def user_identity(name: str) -> str:
    """Return the identity of a user at a command line."""
    return f"user.{name}"


def node_identity(graph: str, node: Node) -> str:
    """Return the identity of a node's process; raises `SettingsError` if it is too long.

    Names contain no dot, so no two processes have the same identity.
    """
    names = check_name(graph, "name", SettingsError), check_name(node.process, "nodes")
    return ".".join(("node", *names))


def check_identity(identity: str) -> str:
    """Return an identity that fits a certificate; raises `SettingsError`."""
    if len(identity) > MOST_LETTERS:
        raise SettingsError(
            f"{identity}: expected a name of up to {MOST_LETTERS} characters, as certificates "
            f"have, got {len(identity)}; shorten what it is made of"
        )
    return identity


def agent_key(label: str, identity: str, verb: str) -> str:
    """Return the key on which an agent serves exactly one identity."""
    return f"fovea/@agent/{label}/{identity}/{verb}"


def check_user(name: str, where: str) -> str:
    """Return the name of a user, such as a login or e-mail address; raises `SettingsError`."""
    if not _USER.fullmatch(name) or ".." in name:
        raise SettingsError(f"{where}: expected a name of letters, digits, - _ . @, got {name!r}")
    return name


def endpoint(address: str, where: str) -> str:
    """Return Zenoh's end point for `HOST[:PORT]` or a unix socket; raises `SettingsError`.

    >>> endpoint("10.0.0.1", "hosts"), endpoint("[::1]:9", "hosts")
    ('tls/10.0.0.1:7447', 'tls/[::1]:9')
    >>> endpoint("router/10.0.0.9", "hosts")
    'router/10.0.0.9:7447'
    """
    if address.startswith(LOCAL):
        return address
    if address.startswith(ROUTED):
        rest = address.removeprefix(ROUTED)
        if rest.startswith((LOCAL, ROUTED)):
            raise SettingsError(f"{where}: expected {ROUTED}HOST[:PORT], got {address!r}")
        return ROUTED + endpoint(rest, where).removeprefix("tls/")
    found = _HOST.fullmatch(address.removeprefix("tls/"))
    if found is None or int(found[2] or AGENT_PORT) > 65535:
        raise SettingsError(f"{where}: expected HOST[:PORT], got {address!r}")
    return f"tls/{found[1]}:{found[2] or AGENT_PORT}"


def endpoint_host(point: str) -> str:
    """Return the host of a TLS end point."""
    return point.removeprefix("tls/").rpartition(":")[0]


def is_routed(point: str) -> bool:
    """Whether an end point is that of an agent behind a router."""
    return point.startswith(ROUTED)


def connected(point: str) -> str:
    """Return the end point to connect to: an agent's own, or that of its router.

    >>> connected("tls/10.0.0.1:7447"), connected("router/10.0.0.9:7447")
    ('tls/10.0.0.1:7447', 'tls/10.0.0.9:7447')
    """
    return f"tls/{point.removeprefix(ROUTED)}" if is_routed(point) else point


def region_of(identity: str) -> str:
    """Return the region, at a router, of the sessions of an identity: up to 32 bytes, for Zenoh."""
    return hashlib.sha256(identity.encode()).hexdigest()[:32]
