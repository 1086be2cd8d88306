"""fovea: two nodes of a graph under its own supervisor, the picture written into the port's memory.

Everything a graph does per message is in the figure: descriptor, frame pool, bus, accounts, thread
hop, handler call. The edge is lossless.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from uuid import uuid4

import numpy as np
from rich.console import Console

from bench.peers.ruler import Meter, Task, Writer, contestant
from pipeline import Frame, Header, Input, Operator, RunError, Source
from pipeline.cli.running import processes
from pipeline.graph.loader import load


@dataclass(frozen=True, kw_only=True)
class TaskSettings:
    """The task, as a graph writes it."""

    nbytes: int
    count: int
    rate_hz: float
    folder: str

    def task(self) -> Task:
        """Return the task of the ruler."""
        return Task(**{**asdict(self), "folder": Path(self.folder)})


class Sender(Source[TaskSettings, Frame]):
    """The sending side."""

    def open(self) -> None:
        """Wait for the receiver."""
        self._writer = Writer(self.settings.task())
        self._numbers = self._writer.paced()
        self._stream = uuid4().hex

    def produce(self) -> dict[str, Frame] | None:
        """Write the next picture into memory of the output."""
        number = next(self._numbers, None)
        if number is None:
            self._writer.save()
            return None
        pixels = self.loan((1, self.settings.nbytes), np.uint8)
        self._writer.write(pixels[0], number)
        stamp_ns = int(pixels[0, 24:32].view(np.int64)[0])
        header = Header(stream=self._stream, seq=number, stamp_ns=stamp_ns)
        return {"out": Frame(header=header, pixels=pixels, pixel_format="grey8")}


class Receiver(Operator[TaskSettings, None]):
    """The receiving side."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        """Report ready, so that the sender begins."""
        self._meter = Meter(self.settings.task())
        self._meter.ready()

    def on_frame(self, frame: Frame) -> None:
        """Read one picture."""
        self._meter.take(frame.pixels[0])

    def close(self) -> None:
        """Write the report."""
        self._meter.save()


def launch(task: Task) -> None:
    """Run the graph until the source ends."""
    settings = {**asdict(task), "folder": str(task.folder)}
    here = "bench.peers.fovea_bus"
    graph = {
        "name": f"ruler-{uuid4().hex[:8]}",  # several may be measured at a time
        "nodes": {
            "sender": {"operator": f"{here}:Sender", "settings": settings},
            "receiver": {
                "operator": f"{here}:Receiver",
                "inputs": {"frame": "sender"},
                "settings": settings,
            },
        },
    }
    path = task.folder / "graph.yaml"
    path.write_text(json.dumps(graph))  # JSON is YAML
    report = processes(load(path), 0, 0.0, Console(stderr=True))
    if failure := report.get("failure"):
        raise RunError(failure)


if __name__ == "__main__":
    contestant("fovea_bus", "fovea", launch)
