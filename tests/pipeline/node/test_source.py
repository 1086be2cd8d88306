"""A source: what of an exposure is sent, what is counted, and the hash of its commands."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from pipeline import Frame, Output, PoolExhausted, Source
from pipeline.bus.ledger import private_ledger
from pipeline.bus.local_transport import LocalReceiver
from pipeline.bus.outport import OutPort, Reader
from pipeline.bus.pool import Lease, PoolWriter
from pipeline.node.source import SourceRunner, fold
from pipeline.run.memory_folder import MemoryFolder
from pipeline.testing import header


class TwoEyes(Source[None, Mapping[str, Frame]]):
    """Two pictures of each exposure."""

    left = Output(Frame)
    right = Output(Frame)
    seq = -1

    def produce(self) -> Mapping[str, Frame]:
        self.seq += 1
        pixels = np.zeros((100, 100, 3), np.uint8)
        frame = Frame(header=header(self.seq), pixels=pixels)
        return {"left": frame, "right": frame}


class FullPool(PoolWriter):
    """Has no free slot."""

    def lease(self, nbytes: int) -> Lease:
        raise PoolExhausted("no slot is free")


class Nobody:
    """Subscribers on the network, of which there are none."""

    def matching(self) -> bool:
        return False


class Readers(Nobody):
    """Takes whatever is sent."""

    def send(self, payload: bytes, only: object = None) -> list[object]:
        return []


@pytest.fixture
def memory() -> Iterator[MemoryFolder]:
    folder = MemoryFolder.claim()
    yield folder
    folder.empty()


def test_an_overrun_is_counted_on_outputs_that_did_not_send(memory: MemoryFolder) -> None:
    ledger = private_ledger(2, 1)
    pools: dict[str, type[PoolWriter]] = {"left": PoolWriter, "right": FullPool}

    def pool_of(name: str) -> Callable[[Callable[[int], int]], PoolWriter]:
        return lambda claim: pools[name](memory, f"eyes.{name}", 3, claim)

    outs = {
        name: OutPort(
            Frame, Readers(), Nobody(), Nobody(),  # type: ignore[arg-type]
            [Reader(ledger.edges[number], lossless=False, depth=2)], pool_of(name), 1,
        )
        for number, name in enumerate(pools)
    }  # fmt: skip
    receiver = LocalReceiver(memory.path / "eyes.recv")
    runner = SourceRunner(
        "eyes", TwoEyes(None), drained=lambda: True, limit=0, inputs={}, edges={}, outs=outs,
        account=ledger.nodes[0], receiver=receiver, lockstep=False, epoch=1,
    )  # fmt: skip

    for _ in range(4):
        runner._expose()
    receiver.close()

    assert [edge.sent for edge in ledger.edges] == [4, 0]
    assert [edge.overrun for edge in ledger.edges] == [0, 4]


@pytest.mark.parametrize(("seq", "same"), [(2**63, False), (2**64 - 1, True), (-1, True)])
def test_a_command_of_any_number_is_hashed(seq: int, same: bool) -> None:
    given, minus_one = hashlib.sha256(), hashlib.sha256()
    frame = Frame(header=header(-1), pixels=np.zeros((1, 1, 3), np.uint8))

    fold(minus_one, frame)
    fold(given, replace(frame, header=header(seq)))

    assert (given.digest() == minus_one.digest()) == same
