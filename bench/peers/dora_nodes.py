"""dora, tuned: pictures written in place (`send_output_raw`) into a pool that holds them all."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from bench.peers.ruler import ROOT, START_S, Meter, Task, Writer, contestant

POOL_BYTES = 256 << 20  # the default of 8 MiB is too small for one region of interest


def receive(task: Task) -> None:
    """Run the receiving side."""
    from dora import Node  # type: ignore[import-not-found, unused-ignore]

    meter = Meter(task)
    node = Node()
    meter.ready()
    for event in node:
        if event["type"] == "INPUT":
            meter.take(event["value"].to_numpy())
    meter.save()  # the sender has ended, and all its messages have arrived


def send(task: Task) -> None:
    """Run the sending side."""
    from dora import Node

    node = Node()
    writer = Writer(task)
    for number in writer.paced():
        with node.send_output_raw("picture", task.nbytes) as memory:
            view = np.asarray(memory, dtype=np.uint8)
            writer.write(view, number)
            del view  # it is sent when the last reference is gone
    writer.save()


def launch(task: Task) -> None:
    """Describe the two nodes and run them with dora, without a permanent daemon."""
    words = ["-m", "bench.peers.dora_nodes", *task.words()]
    common = {"path": sys.executable, "env": _environment()}
    picture = {"source": "sender/picture", "queue_size": task.total}
    graph = {
        "nodes": [
            {"id": "sender", "args": " ".join([*words, "--role=send"]), "outputs": ["picture"]}
            | common,
            {
                "id": "receiver",
                "args": " ".join([*words, "--role=receive"]),
                "inputs": {"picture": picture},
            }
            | common,
        ]
    }
    path = task.folder / "graph.yml"
    path.write_text(json.dumps(graph))  # JSON is YAML
    program = Path(sys.executable).with_name("dora")
    limit_s = START_S + 5 * task.total / task.rate_hz
    subprocess.run(
        [program, "run", path], cwd=task.folder, stdout=sys.stderr, timeout=limit_s, check=True
    )


def _environment() -> dict[str, str]:
    return {"PYTHONPATH": str(ROOT), "DORA_NODE_SHM_POOL_SIZE": str(POOL_BYTES)}


if __name__ == "__main__":
    contestant("dora_nodes", "dora-rs", launch, {"receive": receive, "send": send})
