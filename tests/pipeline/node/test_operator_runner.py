"""A runner calls its operator and holds nothing of a message once it is handled."""

import os
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline import Frame, Input, Operator
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import Ledger, private_ledger
from pipeline.bus.local_transport import LocalReceiver, LocalSender
from pipeline.bus.outport import OutPort, Reader
from pipeline.bus.pool import PoolReader, PoolWriter
from pipeline.messages import Span
from pipeline.node.operator_runner import DELAY_EVERY, MOST_ASKED, OperatorRunner, delay_on_the_way
from pipeline.run.memory_folder import MemoryFolder
from pipeline.testing import header
from tests.pipeline.bus.edges import STEM, Wire
from tests.samples import WorkSettings


class Look(Operator[WorkSettings, None]):
    """Records how many slots its reader pins while it handles a picture."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> None:
        self.pinned = self.pool.pinned


class Scene:
    """A writer, and a reader with its runner, in this process."""

    def __init__(self, folder: Path) -> None:
        self.memory = MemoryFolder.claim()
        self.ledger: Ledger = private_ledger(1, 1)
        account = self.ledger.edges[0]
        account.reader_epoch = 1
        self.pool = PoolReader(self.memory, STEM)
        self.look = Look(WorkSettings())
        self.look.pool = self.pool
        self.receiver = LocalReceiver(folder / "look.recv")
        self.sender = LocalSender([(0, folder / "look.recv")])
        self.runner = OperatorRunner(
            "look", self.look, {"frame": Look.frame}, {"frame": account}, {},
            self.ledger.nodes[0], self.receiver, lockstep=False, epoch=1,
        )  # fmt: skip
        port = InPort(Frame, account, self.pool, 1, lambda a: self.runner.deliver("frame", a))
        self.receiver.expect(0, port.receive)
        self.out = OutPort(
            Frame, self.sender, Wire(), Wire(), [Reader(account, True, 4)],  # type: ignore[arg-type]
            lambda claim: PoolWriter(self.memory, STEM, 3, claim), 1,
        )  # fmt: skip
        self.out.handshake()
        self.runner.attend()

    def close(self) -> None:
        self.sender.close()
        self.receiver.close()
        self.memory.empty()


@pytest.fixture
def scene(short_path: Path) -> Iterator[Scene]:
    made = Scene(short_path)
    yield made
    made.close()


def test_threads_that_deliver_leave_no_file_open(scene: Scene) -> None:
    def deliver(seq: int) -> None:
        head = header(seq)
        scene.out.send(Frame(header=head, pixels=np.zeros((2, 2, 3), np.uint8)), head)
        thread = threading.Thread(target=scene.receiver.wait, args=(60.0,))
        thread.start()
        thread.join()
        scene.runner.step()

    deliver(0)
    before = len(os.listdir("/proc/self/fd"))
    for seq in range(1, 2 * DELAY_EVERY):
        deliver(seq)

    assert len(os.listdir("/proc/self/fd")) <= before + 1  # the one of the runner's own thread


def test_a_picture_is_given_back_as_soon_as_it_is_handled(scene: Scene) -> None:
    for seq in range(3):
        pixels = scene.out.loan((100, 100, 3), np.uint8)
        head = header(seq)
        scene.out.send(Frame(header=head, pixels=pixels), head)

        scene.runner.step()

        assert scene.look.pinned == 1
        assert scene.pool.pinned == 0
    assert scene.ledger.edges[0].delivered == 3


def test_a_question_is_answered_between_two_calls(scene: Scene) -> None:
    answers: list[str] = []
    scene.runner.between(lambda: answers.append("so it is"))
    assert answers == []

    scene.runner.step()

    assert answers == ["so it is"]


def test_questions_do_not_pile_up_behind_a_handler_that_hangs(scene: Scene) -> None:
    taken = [scene.runner.between(lambda: None) for _ in range(MOST_ASKED + 2)]

    assert taken == [True] * MOST_ASKED + [False, False]


@pytest.mark.parametrize(("waited_ns", "counted_ns"), [(3, 3), (5, 5), (900, 5)])
def test_a_scheduling_delay_counts_only_as_far_as_it_delayed_the_message(
    waited_ns: int, counted_ns: int
) -> None:
    before = Span(
        stage="before", received_ns=100, done_ns=120, handler_ns=20, scheduling_delay_ns=0
    )

    assert delay_on_the_way(replace(header(0), trace=(before,)), 125, waited_ns) == counted_ns
    assert delay_on_the_way(replace(header(0), stamp_ns=120), 125, waited_ns) == counted_ns
    assert delay_on_the_way(replace(header(0), stamp_ns=130), 125, waited_ns) == 0
