"""What is kept for a successor is bounded, and it is known where something is missing."""

import pytest

from pipeline.bus.envelope import HANDSHAKE, MESSAGE, Envelope
from pipeline.bus.envelope_buffer import MOST, EnvelopeBuffer


def envelope(ordinal: int, kind: int = MESSAGE, epoch: int = 1) -> Envelope:
    return Envelope.parse(Envelope.render(kind, ordinal, epoch, b"", None, None))


def test_a_buffer_keeps_the_newest_and_tells_that_it_has_lost_the_others() -> None:
    buffer = EnvelopeBuffer(complete_after=0)
    for ordinal in range(1, MOST + 1):
        buffer.add(envelope(ordinal))
    assert (len(buffer.envelopes), buffer.incomplete) == (MOST, False)

    buffer.add(envelope(MOST + 1))

    assert (len(buffer.envelopes), buffer.incomplete) == (MOST, True)
    assert buffer.envelopes[-1].ordinal == MOST + 1


@pytest.mark.parametrize(
    ("ordinals", "incomplete"), [([4, 5, 6], False), ([4, 6], True), ([4, 4], False)]
)
def test_a_gap_behind_the_handshake_makes_a_buffer_incomplete(
    ordinals: list[int], incomplete: bool
) -> None:
    buffer = EnvelopeBuffer()
    buffer.add(envelope(1))  # before the handshake some may be missing: not kept
    buffer.add(envelope(3, HANDSHAKE))

    for ordinal in ordinals:
        buffer.add(envelope(ordinal))

    assert (buffer.complete_after, buffer.incomplete) == (3, incomplete)
    assert [kept.ordinal for kept in buffer.envelopes] == [3, *ordinals]


def test_what_is_finished_is_not_kept() -> None:
    buffer = EnvelopeBuffer(complete_after=0)
    for ordinal in range(1, 6):
        buffer.add(envelope(ordinal))

    buffer.trim(3)

    assert [kept.ordinal for kept in buffer.envelopes] == [4, 5]
