"""Messages are the same after encoding and decoding; anything else is refused."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from pipeline import Detections, Frame, MessageError, Scanpath, Span
from pipeline.codec import dumps, fingerprint, loads, pack, to_bytes, unpack
from pipeline.messages import stamped
from pipeline.testing import header, picture


def detections(n: int, channels: int = 3) -> Detections:
    return Detections(
        header=header(7),
        boxes=np.arange(n * 4, dtype=np.float32).reshape(n, 4),
        angles=np.zeros(n, np.float32),
        scores=np.linspace(0, 1, n, dtype=np.float32),
        labels=np.arange(n, dtype=np.int32),
        features=np.ones((n, channels), np.float32),
        names=("ball", "player"),
    )


@pytest.mark.parametrize("n", [0, 1, 25])
def test_a_message_comes_back_as_it_was_sent(n: int) -> None:
    sent = detections(n)

    got = loads(Detections, dumps(sent))

    assert got.header == sent.header
    assert got.names == sent.names
    for name in ("boxes", "angles", "scores", "labels", "features"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))


def test_the_trace_of_stages_travels_in_the_header() -> None:
    span = Span(stage="saliency", received_ns=1, done_ns=5, handler_ns=3, scheduling_delay_ns=1)
    sent = replace(detections(1), header=stamped(header(3), epoch=2, span=span))

    got = loads(Detections, dumps(sent))

    assert got.header.trace == (span,)
    assert got.header.epoch == 2


def test_received_arrays_are_read_only() -> None:
    got = loads(Detections, dumps(detections(2)))

    with pytest.raises(ValueError, match="read-only"):
        got.boxes[0, 0] = 1


def test_another_schema_is_refused_by_its_fingerprint() -> None:
    with pytest.raises(MessageError, match="another schema"):
        loads(Scanpath, dumps(detections(1)))


def test_the_fingerprint_changes_with_a_field_of_a_nested_type() -> None:
    @dataclass(frozen=True)
    class Inner:
        x: int

    @dataclass(frozen=True)
    class A:
        inner: Inner

    first = fingerprint(A)

    @dataclass(frozen=True)
    class Inner:  # type: ignore[no-redef]
        x: float

    @dataclass(frozen=True)
    class A:  # type: ignore[no-redef]
        inner: Inner

    assert fingerprint(A) != first


def test_sides_that_disagree_are_refused_before_sending() -> None:
    wrong = replace(detections(3), scores=np.zeros(2, np.float32))

    with pytest.raises(MessageError, match="scores"):
        dumps(wrong)


def test_a_type_that_cannot_travel_is_named() -> None:
    @dataclass(frozen=True)
    class Bad:
        what: object

    with pytest.raises(MessageError, match=r"Bad\.what"):
        dumps(Bad(what=1))


@given(arrays.arrays(np.uint8, st.tuples(st.integers(0, 9), st.integers(0, 9), st.just(3))))
def test_any_picture_comes_back(pixels: NDArray[np.uint8]) -> None:
    sent = Frame(header=header(), pixels=pixels, window=(0, 0, 9, 9))

    got = loads(Frame, dumps(sent))

    np.testing.assert_array_equal(got.pixels, pixels)


@given(st.binary(max_size=300))
def test_noise_is_a_message_error_and_nothing_else(noise: bytes) -> None:
    with pytest.raises(MessageError):
        loads(Detections, fingerprint(Detections) + noise)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats() | st.text(max_size=5)
    | st.binary(max_size=9),
    lambda inner: st.lists(inner, max_size=6),
    max_leaves=12,
)  # fmt: skip


@settings(max_examples=300)
@given(st.data())
def test_a_message_with_any_field_replaced_by_junk_is_refused_or_still_valid(
    data: st.DataObject,
) -> None:
    body = pack(detections(2))
    path = data.draw(st.integers(0, len(body) - 1))
    body[path] = data.draw(JUNK)

    try:
        got = unpack(Detections, to_bytes(body))
    except MessageError:
        return
    assert got.boxes.shape[1] == 4
    assert len(got.scores) == len(got.boxes)


def test_an_array_cannot_claim_more_bytes_than_it_brings() -> None:
    body = pack(Frame(header=header(), pixels=picture(2, 2, seed=1)))
    body[1] = ["|u1", [1 << 40, 1 << 40, 3], b"abc"]

    with pytest.raises(MessageError, match=r"Frame\.pixels: expected \d+ bytes"):
        unpack(Frame, to_bytes(body))


@pytest.mark.parametrize("sides", [[0, 1 << 63, 3], [1 << 62, 0, 3], [0, 1 << 40, 3]])
def test_empty_arrays_of_absurd_sides_are_refused_or_empty(sides: list[int]) -> None:
    body = pack(Frame(header=header(), pixels=picture(1, 1, seed=1)))
    body[1] = ["|u1", sides, b""]

    try:
        got = unpack(Frame, to_bytes(body))
    except MessageError:
        return
    assert got.pixels.size == 0


@pytest.mark.parametrize("value", [1 << 64, object(), np.zeros(1, np.complex64)])
def test_a_value_that_msgpack_cannot_encode_is_refused_before_sending(value: object) -> None:
    with pytest.raises(MessageError, match="cannot travel"):
        to_bytes([value])


def test_objects_never_travel() -> None:
    body = pack(Frame(header=header(), pixels=picture(1, 1, seed=1)))
    body[1] = ["|O", [1], b"\0" * 8]

    with pytest.raises(MessageError, match="expected array"):
        unpack(Frame, to_bytes(body))
