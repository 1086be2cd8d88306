"""Any bytes are encoded as one line and decoded unchanged."""

from hypothesis import given
from hypothesis import strategies as st

from pipeline.protocol.lines import as_line, from_line


@given(st.lists(st.binary(max_size=20) | st.text("\x1b01\n", max_size=9).map(str.encode)))
def test_messages_on_a_stream_are_separated_and_arrive_unchanged(messages: list[bytes]) -> None:
    stream = b"".join(map(as_line, messages))

    assert [from_line(line) for line in stream.split(b"\n")[:-1]] == messages
