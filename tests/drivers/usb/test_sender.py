"""Bytes of a payload whose rows have gaps between them arrive as those of one without."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.virtual_board.sender import copy_bytes


@given(rows=st.integers(1, 6), width=st.integers(1, 5), data=st.data())
def test_any_part_of_a_payload_is_copied_as_if_its_rows_followed_one_another(
    rows: int, width: int, data: st.DataObject
) -> None:
    field = np.arange(rows * 9, dtype=np.uint8).reshape(rows, 9)
    window = field[:, 2 : 2 + width]
    start = data.draw(st.integers(0, window.size))
    out = np.empty(data.draw(st.integers(0, window.size - start)), np.uint8)

    copy_bytes(window, start, out)

    assert out.tolist() == window.reshape(-1)[start : start + len(out)].tolist()


def test_a_flat_payload_is_copied_as_it_lies() -> None:
    out = np.empty(3, np.uint8)

    copy_bytes(np.arange(9, dtype=np.uint8), 4, out)

    assert out.tolist() == [4, 5, 6]
