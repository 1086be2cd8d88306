"""What a handover that fails leaves behind."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline import Operator
from pipeline.bus.ledger import private_ledger
from pipeline.node.handover import Handover
from pipeline.protocol.supervision import Cut, CutRefused, Event
from pipeline.run.memory_folder import MemoryFolder


@dataclass(frozen=True)
class Model:
    """A state of some size."""

    weights: bytes


class Keeper(Operator[None, None]):
    def state(self) -> Model:
        return Model(weights=bytes(100_000))

    def restore(self, state: Model) -> None:
        """Take nothing over."""


@pytest.fixture
def memory() -> Iterator[MemoryFolder]:
    folder = MemoryFolder.claim()
    yield folder
    folder.empty()


def handover_of(memory: MemoryFolder, said: list[Event], epoch: int) -> Handover:
    runner: Any = SimpleNamespace(
        operator=Keeper(None), account=private_ledger(0, 1).nodes[0], ports={}, edges={}, outs={},
        name="eye", epoch=epoch, inbox=SimpleNamespace(position=lambda: None), answered=0,
    )  # fmt: skip
    nobody: Any = None
    return Handover(
        runner, memory=memory, say=said.append, queryables=nobody, listen=nobody, standby=False
    )


def test_a_state_that_no_successor_reads_does_not_stay_in_memory(memory: MemoryFolder) -> None:
    said: list[Event] = []
    others = {"eye.out.0badc0de": b"1", "eyes.1.state": b"2"}
    for name, data in others.items():
        memory.write(name, data)
    memory.write("eye.7.state", bytes(1000))  # of a predecessor that was killed

    for epoch in (1, 2, 3):
        handover = handover_of(memory, said, epoch)
        handover.request(Cut(node="eye", receiver=str(memory.path / "gone.recv"), heard={}))
        handover.poll()

    refused = CutRefused("eye", "the successor has closed its receiver")
    assert said == [refused] * 3
    assert [name for name in memory.names() if name.endswith((".state", ".0badc0de"))] == [*others]
