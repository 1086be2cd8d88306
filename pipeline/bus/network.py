"""How a session reaches other hosts: end points, who it is, and what each other may do with it.

Without credentials only unix sockets are allowed; a network address needs TLS in both directions.
What no permit names is denied to every peer.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.errors import SettingsError

Deed = Literal["put", "declare_subscriber", "query", "reply", "declare_queryable"]
LOCAL = "unixsock-stream/"
LARGEST_BYTES = 256 << 20  # no message is longer than this
AGENT_PORT = 7447  # where an agent listens unless it is told otherwise
NODE_PORTS = (7500, 7599)  # first and last, of nodes with an edge to another host, likewise
MOST_SESSIONS = 64
HALF_OPEN = 128  # links that are being opened; a flood of them fills no memory
OPEN_MS = 3000
RETRY_MS = (100, 1000)  # first and last pause between two attempts to reach a host
# of a host that is gone without a word: links are closed after this long without a sign of life
LEASE_MS = 2000


@dataclass(frozen=True, kw_only=True)
class Permit:
    """One thing that the bearer of an identity may do with this session."""

    identity: str  # common name
    inward: tuple[Deed, ...] = ()  # what may come from it
    outward: tuple[Deed, ...] = ()  # what may go to it
    key: str


@dataclass(frozen=True, kw_only=True)
class Network:
    """The end points of a session, its credentials and its permits."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    credentials: str = ""  # folder with ca.pem, own.pem, own.key; empty: unix sockets only
    permits: tuple[Permit, ...] = ()
    # for so long a message waits for a link that takes nothing; then it is lost, and counted
    timeout_ms: int = 0

    def config(self) -> dict[str, Any]:
        """Zenoh's configuration; raises `SettingsError` for a network without credentials."""
        for point in (*self.listen, *self.connect):
            wanted = "tls/" if self.credentials else LOCAL
            if not point.startswith(wanted):
                raise SettingsError(f"{point}: expected {wanted}… here")
        first, last = RETRY_MS
        queue: dict[str, Any] = {"size": {"data": 16, "real_time": 16}}
        if self.timeout_ms:
            wait_us = 1000 * self.timeout_ms
            drop = {"wait_before_drop": wait_us, "max_wait_before_drop_fragments": wait_us}
            queue["congestion_control"] = {"drop": drop}
        config: dict[str, Any] = {
            "mode": "peer",
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
                    "open_timeout": OPEN_MS, "accept_timeout": OPEN_MS,
                    "accept_pending": HALF_OPEN, "max_sessions": MOST_SESSIONS,
                },
                "link": {
                    "tx": {"lease": LEASE_MS, "keep_alive": 4, "queue": queue},
                    "rx": {"max_message_size": LARGEST_BYTES},
                    **({"tls": _tls(Path(self.credentials))} if self.credentials else {}),
                },
            },
        }  # fmt: skip
        if self.credentials:
            config["access_control"] = access_control(self.permits)
        return config


def access_control(permits: tuple[Permit, ...]) -> dict[str, Any]:
    """Zenoh's access list: nothing but the permits."""
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
        # who it is says the common name, which the access list goes by; where it is may change
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
    }  # fmt: skip
