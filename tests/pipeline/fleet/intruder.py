"""An intruder on the network tries everything with the credentials that it has.

python -m tests.pipeline.fleet.intruder CREDENTIALS|-CA_FILE ADDRESS,… SECONDS
"""

import json
import socket
import sys
import threading
import time
from collections import Counter

from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.graph.plan import Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import encode

PLAN = Plan(name="trio", clock="realtime", nodes=(), edges=())
HALF_OPEN = 10  # links to each endpoint; Zenoh pauses for 0.1 s after each that fails
READ = ("fovea/trio/capture/roi/bytes", "fovea/trio/capture/context/bytes", "fovea/**")
FORGED = ("fovea/trio/steer/out/bytes", "fovea/trio/capture/context/bytes")
ASKED = [
    f"fovea/@agent/{label}/{who}/{verb}"
    for label in ("sensor", "compute")
    for who in ("user.tester", "host.compute", "user.intruder", "host.viewer")
    for verb in ("about", "start", "down", "state")
]


class Open(Network):
    """A network without the access list of this project."""

    def config(self) -> dict[str, object]:
        config = super().config()
        config.pop("access_control")
        if self.credentials.startswith("-"):  # TLS without a client certificate
            config["transport"]["link"]["tls"] = {
                "root_ca_certificate": self.credentials[1:],
                "verify_name_on_connect": False,
            }
        return config


def main(credentials: str, points: list[str], seconds: float) -> dict[str, object]:
    network = Open(connect=tuple(f"tls/{p}" for p in points), credentials=credentials)
    session, spy = Session.across(network), Session.across(network)
    seen: Counter[str] = Counter()
    for key in READ:
        spy.hear(key, lambda got, data, key=key: seen.update({f"{key} {got}": 1}))
    time.sleep(1.0)
    senders = {key: session.sender(key) for key in FORGED}
    forged = b"\x97\x02\x01\xce\x7f\xff\xff\xff\x01\xc4\x08forged!!\xc0\x90"
    answers: dict[str, str] = {}
    for key in ASKED:
        data = session.ask(key, question(key.rpartition("/")[2]), 0.15)
        if data is not None:
            answers[key] = data.decode(errors="replace")[:80]
    connections = flood_of_connections(points)
    end, sent = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        for sender in senders.values():
            sender.send(forged)
            sender.send(bytes(200_000))
            sent += 2
        time.sleep(0.001)
    session.close()
    spy.close()
    for one in connections:
        one.close()
    reached = [key for key, sender in senders.items() if sender.matching()]
    return {
        "read": dict(seen), "answers": answers, "sent": sent, "half_open": len(connections),
        "readers_matched": reached,
    }  # fmt: skip


def question(verb: str) -> bytes:
    """Return a valid question, which an agent answers if the identity is permitted."""
    if verb == "about":
        return encode(wire.Nothing())
    if verb == "start":
        return encode(wire.Start(PLAN, wire.Versions.ours(), {}, {}, {}))
    return encode(wire.Named("trio"))


def flood_of_connections(points: list[str]) -> list[socket.socket]:
    """Open many connections that send nothing."""
    found: list[socket.socket] = []

    def connect(point: str) -> None:
        host, _, port = point.rpartition(":")
        try:
            found.append(socket.create_connection((host, int(port)), 0.5))
        except OSError:
            return

    threads = [
        threading.Thread(target=connect, args=(p,)) for p in points for _ in range(HALF_OPEN)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], sys.argv[2].split(","), float(sys.argv[3]))))
