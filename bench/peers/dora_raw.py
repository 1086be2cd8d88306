"""dora, tuned: `send_output_raw` filled in place and a shared-memory pool no picture overflows."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from dora import Node

from bench.peers.ruler import DEADLINE_S, RING, Job, Reader, Writer, command, contest

POOL_BYTES = 1 << 28
SETTLE_S = 0.5
ROOT = Path(__file__).resolve().parents[2]


def produce(job: Job) -> None:
    """Fill in place; leaving the block sends."""
    node, writer = Node(), Writer(job)
    time.sleep(SETTLE_S)
    for seq in writer.turns():
        with node.send_output_raw("picture", job.size_bytes, {"seq": seq}) as memory:
            payload = np.asarray(memory, np.uint8)
            writer.write(payload, seq)
            del payload  # the block refuses to end while a view lives
    writer.save()
    time.sleep(SETTLE_S)


def consume(job: Job) -> None:
    """Read in place until the stream ends."""
    reader = Reader(job)
    for event in Node():
        if event["type"] == "INPUT":
            reader.read(event["value"].to_numpy(), event["metadata"]["seq"])
    reader.save()


def launch(job: Job) -> None:
    """`dora run` plays coordinator and daemon in one process that ends with the graph."""
    graph = Path(job.folder, "graph.yml")
    graph.write_text(json.dumps({"nodes": [_node("produce", job), _node("consume", job)]}))
    dora = Path(sys.executable).with_name("dora")
    with Path(job.folder, "log").open("w+") as log:
        ended = subprocess.run(
            [dora, "run", graph.name], cwd=job.folder, stdout=log, stderr=log, timeout=DEADLINE_S
        )
        if ended.returncode:
            log.seek(0)
            raise SystemExit(f"dora run: status {ended.returncode}: {log.read()[-2000:]}")


def _node(side: str, job: Job) -> dict[str, Any]:
    interpreter, *arguments = command(__spec__.name, side, job)
    node: dict[str, Any] = {
        "id": side,
        "path": interpreter,
        "args": " ".join(arguments),
        "env": {"DORA_NODE_SHM_POOL_SIZE": str(POOL_BYTES), "PYTHONPATH": str(ROOT)},
    }
    if side == "produce":
        return {**node, "outputs": ["picture"]}
    return {**node, "inputs": {"picture": {"source": "produce/picture", "queue_size": RING}}}


if __name__ == "__main__":
    packages = ("dora-rs", "pyarrow", "numpy")
    contest("dora tuned", packages, launch, produce=produce, consume=consume)
