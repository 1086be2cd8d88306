"""Plain Zenoh: the picture inside the message, over a unix socket, no shared memory."""

import json
import time
from typing import Any

import numpy as np
import zenoh

from bench.peers.ruler import Meter, Task, Writer, contestant, two_processes

KEY = "bench/picture"
POLL_S = 0.01


def receive(task: Task) -> None:
    """Run the receiving side in the transport's own thread, which saves a hop."""
    meter = Meter(task)

    def on_sample(sample: zenoh.Sample) -> None:
        meter.take(np.frombuffer(sample.payload.to_bytes(), np.uint8))

    with _session(task, "listen") as session:
        session.declare_subscriber(KEY, zenoh.handlers.Callback(on_sample, indirect=False))
        meter.ready()
        while not meter.finished:
            time.sleep(POLL_S)
    meter.save()


def send(task: Task) -> None:
    """Run the sending side."""
    writer = Writer(task)
    payload = bytearray(task.nbytes)
    view = np.frombuffer(payload, np.uint8)
    with _session(task, "connect") as session:
        publisher = session.declare_publisher(
            KEY, congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )
        while not publisher.matching_status:
            time.sleep(POLL_S)
        for number in writer.paced():
            writer.write(view, number)
            publisher.put(payload)
        writer.save()
        writer.wait_read()  # a session that closes drops what is still queued


def _session(task: Task, end: str) -> Any:
    config = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},
        "listen": {"endpoints": []},
    }
    config[end] = {"endpoints": [f"unixsock-stream/{task.folder / 'link.sock'}"]}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


if __name__ == "__main__":
    contestant(
        "zenoh_bytes", "eclipse-zenoh", two_processes("zenoh_bytes"),
        {"receive": receive, "send": send},
    )  # fmt: skip
