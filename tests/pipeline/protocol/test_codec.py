"""Every message survives encoding and decoding; anything else is refused in one sentence."""

import gc
import weakref
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import FoveaError, MessageError, RunError
from pipeline.protocol.codec import (
    MARKER,
    MOST_BYTES,
    TAG,
    VERSION,
    ControlMessage,
    Kind,
    Refused,
    decode,
    decode_answer,
    encode,
    refused,
)
from pipeline.protocol.orders import ORDER, RESULT, StopOrder, StopResult, SwapOrder
from pipeline.protocol.questions import QUESTION, Health, Outcome, SchemaQuestion
from pipeline.protocol.supervision import EVENT, INSTRUCTION
from tests.pipeline.protocol.strategies import message_classes, messages

KINDS: list[Kind[Any] | type[Any]] = [
    ORDER, RESULT, QUESTION, INSTRUCTION, EVENT, *message_classes(),
]  # fmt: skip
EVERY = st.sampled_from(message_classes()).flatmap(messages)


class Held:
    """An object that a stack frame holds while it refuses a message."""


def refuse(_held: Held, data: bytes) -> None:
    try:
        decode(ORDER, data)
    except MessageError:
        return


def sentence(kind: Kind[Any] | type[Any], data: bytes) -> str:
    """Return the sentence in which a decoder refuses bytes; fail if it does not refuse them."""
    with pytest.raises(MessageError) as refusal:
        decode(kind, data)
    said = str(refusal.value)
    assert "\n" not in said
    assert said.isprintable()
    assert len(said) < 1000
    return said


@given(EVERY)
def test_every_message_is_the_same_after_encoding_and_decoding(message: ControlMessage) -> None:
    assert decode(type(message), encode(message)) == message


def test_no_two_messages_have_one_name() -> None:
    names = [cls.__name__ for cls in message_classes()]

    assert len(names) == len(set(names))


@given(st.sampled_from(KINDS), st.binary(max_size=80), st.booleans())
def test_noise_is_refused_in_one_sentence(kind: Any, noise: bytes, begins_well: bool) -> None:
    data = bytes((MARKER, VERSION)) + noise if begins_well else noise
    said = ""
    try:
        decode(kind, data)
    except FoveaError as error:
        said = str(error)

    assert said or begins_well
    assert "\n" not in said
    assert len(said) < 1000


@given(EVERY, st.integers(0, 255).filter(lambda version: version != VERSION))
def test_another_version_is_refused_with_both_named(message: ControlMessage, version: int) -> None:
    data = bytes((MARKER, version)) + encode(message)[2:]

    said = sentence(type(message), data)

    assert f"expected protocol version {VERSION}, got version {version}" in said


@given(EVERY, st.sampled_from(KINDS))
def test_a_message_of_another_kind_is_refused(message: ControlMessage, kind: Any) -> None:
    if type(message) in (kind.classes if isinstance(kind, Kind) else (kind,)):
        return

    said = sentence(kind, encode(message))

    assert f", got {type(message).__name__}" in said


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({TAG: "Jump"}, "not an order: expected SwapOrder or PlanOrder or StopOrder, got Jump"),
        ({TAG: "SwapOrder", "node": "a", "speed": 1}, "Object contains unknown field `speed`"),
        ({TAG: "SwapOrder", "node": 3}, "Expected `str`, got `int` - at `$.node`"),
        ({TAG: "SwapOrder", "node": "a", "probation": 0}, "Expected `int` >= 1"),
        ({TAG: "SwapOrder", "node": "a" * 201}, "Expected `str` of length <= 200"),
        ({TAG: "SwapOrder"}, "Object missing required field `node`"),
        ({"node": "a"}, "Object missing required field `kind`"),
        ({TAG: 3}, "not an order: Expected `str`"),
        ({TAG: "Jump\x1b[2J" + "x" * 1000}, r"got Jump\x1b[2Jxx"),
    ],
)
def test_a_wrong_order_is_refused_with_the_reason(body: Any, said: str) -> None:
    data = bytes((MARKER, VERSION)) + msgspec.msgpack.encode(body)

    assert said in sentence(ORDER, data)


def test_a_refusal_does_not_keep_what_led_to_it_alive() -> None:
    gc.collect()
    gc.disable()  # a question is answered when its last reference is gone
    try:
        held = Held()
        gone = weakref.ref(held)
        refuse(held, bytes((MARKER, VERSION)) + msgspec.msgpack.encode("noise"))
        del held
        assert gone() is None
    finally:
        gc.enable()


def test_too_many_bytes_are_refused_without_decoding_them() -> None:
    said = sentence(Health, bytes(MOST_BYTES + 1))

    assert said == f"not a Health: expected up to {MOST_BYTES} bytes, got {MOST_BYTES + 1}"


@pytest.mark.parametrize("data", [b"", b"\xf5", b"{}", b'{"type": "swap", "node": "a"}'])
def test_bytes_that_are_no_message_are_refused_as_such(data: bytes) -> None:
    said = sentence(ORDER, data)

    assert said == f"not an order: expected a message, got {len(data)} other bytes"


def test_values_that_cannot_travel_are_refused_where_they_are_sent() -> None:
    for value in (1 << 64, "\ud800", object()):
        with pytest.raises(MessageError, match="cannot travel"):
            encode(SwapOrder(node="a", changes={"x": value}))


def test_a_refusal_in_the_place_of_an_answer_is_raised() -> None:
    data = encode(refused("work: no\nsuch thing"))

    with pytest.raises(RunError, match=r"^eye: work: no such thing$"):
        decode_answer(Outcome, data, "eye")


def test_answers_and_messages_without_fields_are_told_apart() -> None:
    assert decode_answer(StopResult, encode(StopResult(graph="g", pid=1))).pid == 1
    assert decode(ORDER, encode(StopOrder())) == StopOrder()
    assert decode(QUESTION, encode(SchemaQuestion())) == SchemaQuestion()
    assert decode(Refused, encode(Refused("no", rolled_back=True))).rolled_back
