"""One edge for tests of its two ends, without a network."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline import Frame, Message
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import EdgeAccount, private_ledger
from pipeline.bus.outport import Arrival, OutPort, Reader
from pipeline.bus.pool import PoolReader, PoolWriter
from pipeline.run.memory_folder import MemoryFolder
from pipeline.testing import header

STEM = "eye.out"


class Wire:
    """A sender that keeps what was sent."""

    def __init__(self, *, matched: bool = False) -> None:
        self.sent: list[bytes] = []
        self.matched = matched
        self.fresh = False

    def connect(self) -> bool:
        """Return whether a link is new."""
        return self.fresh

    def set_targets(self, *_: object) -> None:
        """Do nothing: there is one reader."""

    def send(self, payload: bytes) -> list[int]:
        self.sent.append(payload)
        return []

    def matching(self) -> bool:
        return self.matched


class Edge:
    """One writer, one reader and the account between them."""

    message: type[Message] = Frame
    address: Callable[[int], Path] | None = None

    def __init__(self, *, lossless: bool = True, depth: int = 4, remote: bool = False) -> None:
        self.memory = MemoryFolder.claim()
        self.account: EdgeAccount = private_ledger(1, 0).edges[0]
        self.account.reader_epoch = 1
        self.wire, self.taps, self.remote = Wire(), Wire(), Wire(matched=remote)
        self.lossless, self.depth = lossless, depth
        self.arrivals: list[Arrival] = []
        self.out = self.writer(1)
        self.port = self.reader(1)

    def writer(self, epoch: int) -> OutPort:
        readers = [Reader(self.account, self.lossless, self.depth, address=self.address)]
        return OutPort(
            self.message, self.wire, self.taps, self.remote, readers,  # type: ignore[arg-type]
            lambda claim: PoolWriter(self.memory, STEM, 3, claim), epoch,
        )  # fmt: skip

    def reader(self, epoch: int, *, tap: bool = False) -> InPort:
        pool = PoolReader(self.memory, STEM)
        return InPort(self.message, self.account, pool, epoch, self.arrivals.append, tap=tap)

    def send(self, seq: int, side_px: int = 60) -> None:
        pixels = self.out.loan((side_px, side_px, 3), np.uint8)
        pixels[...] = seq % 251
        head = header(seq)
        self.out.send(Frame(header=head, pixels=pixels), head)

    def carry(self) -> None:
        for payload in self.wire.sent:
            self.port.receive(payload)
        self.wire.sent.clear()

    def finish(self) -> None:
        """Acknowledge all that arrived, as an operator that handled it."""
        self.account.acknowledge("delivered", len(self.arrivals))
        self.arrivals.clear()
