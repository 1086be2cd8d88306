"""Network settings of a session: end points, credentials, and the permissions of each peer.

Without credentials only unix sockets are allowed; a network address requires mutual TLS. Peers are
denied everything that no permit names.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.errors import SettingsError

Deed = Literal["put", "declare_subscriber", "query", "reply", "declare_queryable"]
LOCAL = "unixsock-stream/"
LARGEST_BYTES = 256 << 20  # upper limit of a message
AGENT_PORT = 7447  # where an agent listens by default
NODE_PORTS = (7500, 7599)  # default range for nodes with an edge to another host
MOST_SESSIONS = 256  # each of 64 hosts, those who watch, and links that have not yet ended
MOST_ROUTED = 1024  # sessions at a router
HALF_OPEN = 128  # links being opened at once, so that a flood of them fills no memory
RETRY_MS = (100, 1000)  # first and longest pause between attempts to reach a host
# An attempt to open a link is given up after this time. Zenoh's TLS listener pauses 100 ms after
# each handshake that was given up (its issue 2685), ten in a second: where more openers than that
# lose patience with a router that is busy, it hears only those that have gone, and none gets in.
OPEN_MS = 10_000
ROUTED_OPEN_MS = 20_000
# Links to a host that has vanished are closed after this time without a sign of life. A pause of a
# router would end all of its links; that a cable was pulled is known sooner (`bus.sockets`).
LEASE_MS = 2000
ROUTED_LEASE_MS = 10_000
ALIVE_MS = 500  # from one sign of life to the next


@dataclass(frozen=True, kw_only=True)
class Permit:
    """A permission of an identity on this session."""

    identity: str  # common name
    inward: tuple[Deed, ...] = ()  # what it may send to this session
    outward: tuple[Deed, ...] = ()  # what this session may send to it
    key: str


@dataclass(frozen=True, kw_only=True)
class Network:
    """The end points of a session, its credentials and its permits."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    credentials: str = ""  # folder with ca.pem, own.pem, own.key; empty: unix sockets only
    permits: tuple[Permit, ...] = ()
    # A router carries messages between regions. A session behind one names its own, which nobody
    # else has, because within a region Zenoh expects direct links.
    region: str = ""
    routes: tuple[str, ...] = ()  # the regions behind this session; not empty: it is a router
    # a message waits this long for a blocked link; then it is lost, and counted
    timeout_ms: int = 0

    def config(self) -> dict[str, Any]:
        """Return Zenoh's configuration; raises `SettingsError` without required credentials."""
        for point in (*self.listen, *self.connect):
            wanted = "tls/" if self.credentials else LOCAL
            if not point.startswith(wanted):
                raise SettingsError(f"{point}: expected {wanted}… here")
        first, last = RETRY_MS
        routed = self.region or self.routes
        open_ms = ROUTED_OPEN_MS if routed else OPEN_MS
        lease_ms = ROUTED_LEASE_MS if routed else LEASE_MS
        queue: dict[str, Any] = {"size": {"data": 16, "real_time": 16}}
        if self.timeout_ms:
            wait_us = 1000 * self.timeout_ms
            drop = {"wait_before_drop": wait_us, "max_wait_before_drop_fragments": wait_us}
            queue["congestion_control"] = {"drop": drop}
        config: dict[str, Any] = {
            "mode": "router" if self.routes else "peer",
            "listen": {"endpoints": list(self.listen)},
            "connect": {
                "endpoints": list(self.connect),
                "exit_on_failure": False,
                "timeout_ms": -1,  # keep trying; opening does not wait for it
                "retry": {
                    "period_init_ms": first, "period_max_ms": last, "period_increase_factor": 2,
                },
            },
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {
                "shared_memory": {"enabled": False},
                "unicast": {
                    "open_timeout": open_ms, "accept_timeout": open_ms,
                    "accept_pending": HALF_OPEN,
                    "max_sessions": MOST_ROUTED if self.routes else MOST_SESSIONS,
                },
                "link": {
                    "tx": {"lease": lease_ms, "keep_alive": lease_ms // ALIVE_MS, "queue": queue},
                    "rx": {"max_message_size": LARGEST_BYTES},
                    **({"tls": _tls(Path(self.credentials))} if self.credentials else {}),
                },
            },
        }  # fmt: skip
        if self.region:
            config["region_name"] = self.region
        if self.routes:
            south = [{"filters": [{"region_names": [name]}]} for name in self.routes]
            config["gateway"] = {"south": south}
        if self.credentials:
            config["access_control"] = access_control(self.permits)
        return config


def access_control(permits: tuple[Permit, ...]) -> dict[str, Any]:
    """Return Zenoh's access-control list, which allows only the permits."""
    rules, subjects, policies = [], [], []
    for number, permit in enumerate(permits):
        subjects.append({"id": f"s{number}", "cert_common_names": [permit.identity]})
        named = []
        for flow, deeds in (("ingress", permit.inward), ("egress", permit.outward)):
            if deeds:
                named.append(f"r{number}-{flow}")
                rules.append(
                    {
                        "id": named[-1], "permission": "allow", "flows": [flow],
                        "messages": list(deeds), "key_exprs": [permit.key],
                    }
                )  # fmt: skip
        policies.append({"rules": named, "subjects": [f"s{number}"]})
    return {
        "enabled": True, "default_permission": "deny",
        "rules": rules, "subjects": subjects, "policies": policies,
    }  # fmt: skip


def _tls(credentials: Path) -> dict[str, Any]:
    own, key = str(credentials / "own.pem"), str(credentials / "own.key")
    return {
        "root_ca_certificate": str(credentials / "ca.pem"),
        "enable_mtls": True,
        "listen_certificate": own, "listen_private_key": key,
        "connect_certificate": own, "connect_private_key": key,
        # the access list checks the common name; the address of a peer may change
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
    }  # fmt: skip
