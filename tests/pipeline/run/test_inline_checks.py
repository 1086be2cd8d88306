"""A wrong operator is refused in the same words however it is run: by itself, in line, in a graph.

Ways: as a process of a graph, in the in-line runner, by `drive`, as the shadow of another.
"""

import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import FoveaError, Frame, GraphError, MessageError, Operator, RunError, Source
from pipeline.bus.envelope_buffer import EdgeCut
from pipeline.bus.inbox import InboxPosition
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import private_ledger
from pipeline.bus.local_transport import LocalReceiver
from pipeline.bus.outport import Arrival, OutPort
from pipeline.codec import carried, dumps, loads, to_bytes, unpack
from pipeline.contract import inputs_of, outputs_of
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import load_operator
from pipeline.messages import altered
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.shadow import Shadow
from pipeline.node.source import SourceRunner
from pipeline.run.inline import InlineRunner
from pipeline.testing import drive, header, picture
from tests.pipeline.bus.edges import Wire
from tests.sample_graphs import go, plan_of
from tests.samples import Pair
from tests.wrong_samples import Beside, Wrong, WrongSettings, percept

READER = """\
nodes:
  maker:
    operator: tests.wrong_samples:Maker
  wrong:
    operator: tests.wrong_samples:{cls}
    inputs: {{frame: maker.left}}
    settings: {{answer: {answer}}}
    restart: {{policy: never}}
"""
MAKER = """\
nodes:
  wrong:
    operator: tests.wrong_samples:Maker
    {inputs}
    settings: {{answer: {answer}}}
    restart: {{policy: never}}
  work:
    operator: tests.samples:Pass
    inputs: {{frame: wrong.left}}
"""
COMMANDED = "a command"
WORDS = {
    ("Wrong", "a number"): "wrong: expected a message per output (out) or None, got an int",
    ("Wrong", "a list"): "wrong: expected a message per output (out) or None, got a list",
    ("Wrong", "an unknown output"):
        "wrong: expected answers for its outputs (out), got one for 'oops'",
    ("Wrong", "an unknown output of a mapping"):
        "wrong: expected answers for its outputs (out), got one for 'oops'",
    ("Wrong", "a number for an output"): "wrong.out: expected a Frame or None, got an int",
    ("Wrong", "another message"): "wrong.out: expected a Frame or None, got a Percept",
    ("Wrong", "a subclass"): "wrong.out: expected a Frame or None, got a Smaller",
    ("Wrong", "another dtype"):
        "wrong.out: Frame.pixels: expected array[<u2||u1](h, w) or (h, w, 3), got <f8",
    ("Wrong", "no array"):
        "wrong.out: Frame.pixels: expected array[<u2||u1](h, w) or (h, w, 3), got list",
    ("Wrong", "another shape"):
        "wrong.out: Frame.pixels: expected shape (h, w) or (h, w, 3), got (16, 16, 2)",
    ("Wrong", "a number as a string"):
        "wrong.out: Frame.command_seq: expected int, got a str '7'",
    ("Wrong", "a fraction"): "wrong.out: Frame.command_seq: expected int, got a float 7.5",
    ("Wrong", "too short a tuple"):
        "wrong.out: Frame.window: expected tuple4[int,int,int,int], got a tuple (0, 0, 1)",
    ("Wrong", "no string"): "wrong.out: Frame.status: expected str, got None",
    ("Wrong", "too great a number"):
        "wrong.out: cannot travel: can't serialize ints < -2**63 or > 2**64 - 1",
    ("Wrong", "written input"): "assignment destination is read-only",
    ("Mute", "a message"): "wrong: expected None, got a Frame",
    ("Mute", "a number"): "wrong: expected None, got an int",
    ("Beside", "a message"): "wrong.on_frame: expected no answer, got a Frame",
    ("Named", "a message"):
        "wrong: expected a message per output (picture, report) or None, got a Frame",
    ("Named", "another message"): "wrong.report: expected a Percept or None, got a Frame",
    ("Deaf", "a message"): "Deaf: no handler on_frame for its inputs",
}  # fmt: skip
OF_SOURCES = {
    "a message":
        "wrong.produce: expected a mapping of outputs (left, right) to messages or None, got a "
        "Frame",
    "no message": "wrong.produce: expected a message or None, got no message",
    "an unknown output":
        "wrong: expected answers for its outputs (left, right), got one for 'oops'",
    "another message": "wrong.left: expected a Frame or None, got a Percept",
    "two exposures": "wrong.produce: expected one exposure, got several",
    "no header": "wrong.produce: expected a Header in each message, got None",
    "a header of strings":
        "wrong.produce: Header.stamp_ns: expected int, got a str 'x'",
    "another shape":
        "wrong.left: Frame.pixels: expected shape (h, w) or (h, w, 3), got (3,)",
}  # fmt: skip


def frame(seq: int = 0) -> Frame:
    return Frame(header=header(seq), pixels=picture(16, 16, seed=seq))


@contextmanager
def runner_of(folder: Path, cls: str, answer: str) -> Iterator[OperatorRunner]:
    """Yield the runner of an operator without a graph."""
    operator: type[Operator[Any, Any]] = load_operator(f"tests.wrong_samples:{cls}")
    subject = operator(WrongSettings(answer=answer))
    subject.open()
    ledger, receiver = private_ledger(1, 1), LocalReceiver(folder / "wrong.recv")
    outs = {
        name: OutPort(message, Wire(), Wire(), Wire(), [], lambda _claim: None, 1)  # type: ignore[arg-type,return-value]
        for name, message in outputs_of(operator).items()
    }
    (name,) = inputs_of(operator)
    common: dict[str, Any] = {"lockstep": False, "epoch": 1}
    more = {"drained": lambda: True, "limit": 0} if issubclass(operator, Source) else {}
    runner = (SourceRunner if more else OperatorRunner)(
        "wrong", subject, inputs_of(operator), {name: ledger.edges[0]}, outs, ledger.nodes[0],
        receiver, **common, **more,
    )  # fmt: skip
    try:
        yield runner
    finally:
        receiver.close()


def arrival() -> Arrival:
    return Arrival(header(), carried(frame()), 1)


def by_a_host(folder: Path, cls: str, answer: str) -> None:
    with runner_of(folder, cls, answer) as runner:
        runner.deliver("frame", arrival())
        runner.step()


def by_a_source_host(folder: Path, answer: str) -> None:
    with runner_of(folder, "Maker", answer) as runner:
        assert isinstance(runner, SourceRunner)
        runner._expose()
        runner.deliver("schedule", arrival())
        work = runner.next_work(0.0)
        assert work is not None
        runner._accept(work)


def by_a_shadow(folder: Path, cls: str, answer: str) -> None:
    with runner_of(folder, cls, answer) as runner:
        account = runner.edges["frame"]
        runner.ports["frame"] = InPort(
            Frame, account, None, 1, lambda _: None, holding=True  # type: ignore[arg-type]
        )  # fmt: skip
        edges = {"frame": EdgeCut(0, [], 1)}
        shadow = Shadow(runner, InboxPosition("", [], -1, {}), edges, queue.SimpleQueue(), 1)
        shadow._deliver("frame")(arrival())
        shadow.step()


def by_drive(_folder: Path, cls: str, answer: str) -> None:
    operator: type[Any] = load_operator(f"tests.wrong_samples:{cls}")
    named = operator if cls == "Deaf" else type("wrong", (operator,), {})
    drive(named, [{inputs: frame() for inputs in inputs_of(operator)}], {"answer": answer})


def in_line(folder: Path, cls: str, answer: str) -> None:
    text = MAKER if cls == "Maker" else READER
    inputs = "inputs: {schedule: work}" if answer == COMMANDED else ""
    plan = plan_of(folder, text.format(cls=cls, answer=answer, inputs=inputs), clock="lockstep")
    with InlineRunner(plan) as runner:
        list(runner.run(2))


def as_processes(folder: Path, cls: str, answer: str) -> None:
    text = MAKER if cls == "Maker" else READER
    plan = plan_of(folder, text.format(cls=cls, answer=answer, inputs=""), clock="lockstep")
    raise RunError(go(plan, 3)["failure"])


Way = Callable[[Path, str, str], None]


@pytest.mark.parametrize("way", [by_a_host, by_a_shadow, by_drive, in_line])
@pytest.mark.parametrize(("cls", "answer"), WORDS, ids=str)
def test_a_wrong_answer_is_the_same_error_in_every_way(
    way: Way, cls: str, answer: str, short_path: Path
) -> None:
    if (way, cls) == (in_line, "Deaf"):
        pytest.skip("the loader refuses it before")

    with pytest.raises((FoveaError, ValueError)) as caught:
        way(short_path, cls, answer)

    assert str(caught.value) == WORDS[cls, answer]


@pytest.mark.parametrize("answer", OF_SOURCES)
def test_a_wrong_exposure_is_the_same_error_in_every_way(answer: str, short_path: Path) -> None:
    with pytest.raises(FoveaError) as hosted:
        by_a_source_host(short_path, answer)
    with pytest.raises(FoveaError) as inline:
        in_line(short_path, "Maker", answer)

    assert str(hosted.value) == str(inline.value) == OF_SOURCES[answer]


def test_a_command_that_is_answered_is_the_same_error_in_every_way(short_path: Path) -> None:
    said = "wrong.on_schedule: expected no answer, got an int"

    with pytest.raises(RunError) as hosted:
        by_a_source_host(short_path, COMMANDED)
    with pytest.raises(RunError) as inline:
        in_line(short_path, "Maker", COMMANDED)
    with pytest.raises(RunError) as driven:
        by_drive(short_path, "Maker", COMMANDED)

    assert {str(e.value) for e in (hosted, inline, driven)} == {said}


@pytest.mark.parametrize(
    ("cls", "answer", "said"),
    [
        ("Wrong", "a fraction", WORDS["Wrong", "a fraction"]),
        ("Maker", "another shape", OF_SOURCES["another shape"]),
    ],
)
def test_a_wrong_answer_ends_a_graph_of_processes_in_the_same_words(
    cls: str, answer: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(RunError) as caught:
        as_processes(tmp_path, cls, answer)

    assert said in str(caught.value)


TWO = """\
nodes:
  left:
    operator: tests.samples:Ticker
  right:
    operator: tests.samples:Ticker
"""


def test_two_sources_are_named_where_there_can_be_one(tmp_path: Path) -> None:
    plan, source = plan_of(tmp_path, TWO), tmp_path / "source.yaml"
    source.write_text("settings: {rate_hz: 30}\n")
    said = "node that makes frames, got 2: left, right"

    with pytest.raises(GraphError, match=f"{said}; several run as processes, without --inline"):
        InlineRunner(plan)
    with pytest.raises(GraphError, match=f"graph.yaml: --source needs one {said}$"):
        load(tmp_path / "graph.yaml", Overlay(source=source))


def test_values_that_the_codec_accepts_are_converted_in_line_as_by_the_codec() -> None:
    numbers = replace(frame(), command_seq=np.int32(7), window=[0, 0, 1, np.int64(1)])  # type: ignore[arg-type]

    got, sent = carried(numbers), loads(Frame, dumps(numbers))

    for one in (got, sent):
        assert (type(one.command_seq), one.command_seq) == (int, 7)
        assert (type(one.window), one.window) == (tuple, (0, 0, 1, 1))


def test_readers_in_line_share_the_memory_of_a_picture_and_may_not_write_into_it() -> None:
    given = frame()

    got = carried(given)

    assert np.shares_memory(got.pixels, given.pixels)
    assert not got.pixels.flags.writeable
    assert given.pixels.flags.writeable


def test_a_part_of_a_picture_reaches_readers_in_one_piece_as_by_the_wire() -> None:
    part = replace(frame(), pixels=frame().pixels[::2, ::2])

    got = carried(part)

    assert got.pixels.flags.c_contiguous
    np.testing.assert_array_equal(got.pixels, part.pixels)


PLAIN = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
ODD = PLAIN | st.binary(max_size=3) | st.lists(PLAIN, max_size=4) | st.tuples(PLAIN, PLAIN)


@given(name=st.sampled_from(["window", "status", "command_seq", "pixel_format"]), value=ODD)
def test_what_is_refused_in_line_is_what_the_reader_of_the_wire_refuses(
    name: str, value: Any
) -> None:
    message = altered(frame(), **{name: value})
    unchecked = [getattr(message, f.name) for f in fields(Frame)]
    unchecked[1] = ("|u1", message.pixels.shape, message.pixels.tobytes())

    def works(act: Callable[[], object]) -> bool:
        try:
            act()
        except MessageError:
            return False
        return True

    assert works(lambda: carried(message)) == works(lambda: unpack(Frame, to_bytes(unchecked)))


@pytest.mark.parametrize(
    ("operator", "message", "settings", "said"),
    [
        (Wrong, frame(), {"answr": ""}, r"Wrong\.answr: no such setting, did you mean 'answer'"),
        (Wrong, frame(), {"answer": 5}, r"Wrong\.answer: input should be a valid string, got 5"),
        (Wrong, 5, {}, "Wrong: expected a message or a mapping of inputs to messages, got int"),
        (Wrong, {}, {}, "Wrong: expected a message or a mapping of inputs to messages, got dict"),
        (Wrong, {"fram": frame()}, {}, "Wrong: no input fram, did you mean 'frame'"),
        (Wrong, {"frame": 5}, {}, r"Wrong\.frame: expected a Frame, got int"),
        (Wrong, percept(header()), {}, r"Wrong\.frame: expected a Frame, got Percept"),
        (Wrong, {"frame": None}, {}, r"Wrong\.frame: expected a Frame, got NoneType"),
        (Pair, {"left": frame()}, {}, r"Pair\.right: expected a Frame, got none"),
        (Beside, frame(), {}, "Beside: expected a mapping of inputs to messages, got Frame"),
        (Wrong, altered(frame(), pixels=np.zeros(3, np.uint8)), {},
            r"Wrong\.frame: Frame\.pixels: expected shape .*, got \(3,\)"),
        (Wrong, altered(frame(), status=7), {},
            r"Wrong\.frame: Frame\.status: expected str, got an int 7"),
    ],
)  # fmt: skip
def test_wrong_arguments_of_drive_are_refused_in_one_sentence(
    operator: type[Any], message: Any, settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(FoveaError, match=f"^{said}"):
        drive(operator, [message], settings)
