"""Zenoh as it comes: the payload inside the message, over a unix socket, no shared memory."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from bench.peers.ruler import IDLE_S, Job, Reader, Writer, contest, duet

KEY = "bench/picture"


def produce(job: Job) -> None:
    """Fill own memory, put it, the number as the attachment."""
    payload, writer = bytearray(job.size_bytes), Writer(job)
    view = np.frombuffer(payload, np.uint8)
    with _session(job, connect=True) as session:
        publisher = session.declare_publisher(
            KEY, congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )
        while not publisher.matching_status:
            time.sleep(0.01)
        for seq in writer.turns():
            writer.write(view, seq)
            publisher.put(payload, attachment=seq.to_bytes(8, "little"))
        writer.save()


def consume(job: Job) -> None:
    """Read each in the transport's own thread, which saves a hop."""
    reader = Reader(job)

    def receive(sample: zenoh.Sample) -> None:
        payload = np.frombuffer(sample.payload.to_bytes(), np.uint8)
        assert sample.attachment is not None
        reader.read(payload, int.from_bytes(sample.attachment.to_bytes(), "little"))

    with _session(job, connect=False) as session:
        session.declare_subscriber(KEY, zenoh.handlers.Callback(receive, indirect=False))
        reader.ready()
        while not reader.over():
            time.sleep(IDLE_S)
    reader.save()


def _session(job: Job, *, connect: bool) -> Any:
    link = [f"unixsock-stream/{Path(job.folder, 'link.sock')}"]
    ends = {"connect": {"endpoints": link}} if connect else {"listen": {"endpoints": link}}
    config = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},
        "listen": {"endpoints": []},
        **ends,
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


if __name__ == "__main__":
    duo = duet(__spec__.name)
    contest("zenoh bytes", ("eclipse-zenoh", "numpy"), duo, produce=produce, consume=consume)
