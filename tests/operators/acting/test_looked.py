"""What the ROI has shown: known until the context changes there."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.acting.looked import followed, means, nothing_looked, shown
from tests.operators.acting.samples import CONTEXT, FIELD

WINDOW = 160, 120, 320, 240


def still(level: int = 100) -> np.ndarray:
    return np.full(CONTEXT, level, np.uint8)


def test_nothing_is_known_before_the_roi_showed_it() -> None:
    assert not followed(nothing_looked(), still(), 6).known.any()


def test_what_the_roi_showed_is_known_while_the_context_stays() -> None:
    state = shown(followed(nothing_looked(), still(), 6), still(), WINDOW, FIELD, 4)

    after = followed(state, still(103), 6)

    share = means(after.known.astype(np.float32), np.array([WINDOW, (400, 300, 560, 420)]), FIELD)
    np.testing.assert_allclose(share, [1, 0])
    assert set(after.shown_seq[after.known]) == {4}


def test_a_change_of_the_context_is_forgotten_only_where_it_is() -> None:
    state = shown(followed(nothing_looked(), still(), 6), still(), WINDOW, FIELD, 4)
    changed = still()
    changed[:30] = 180

    after = followed(state, changed, 6)

    assert not after.known[:30].any()
    assert after.known[30:41, 28:54].all()


def test_a_slow_change_counts_from_when_it_was_shown() -> None:
    state = shown(followed(nothing_looked(), still(), 6), still(), WINDOW, FIELD, 4)

    for level in (102, 104, 106):
        state = followed(state, still(level), 6)

    assert not state.known.any()


def test_a_context_of_another_size_begins_anew() -> None:
    state = shown(followed(nothing_looked(), still(), 6), still(), WINDOW, FIELD, 4)

    assert not followed(state, np.zeros((41, 55, 3), np.uint8), 6).known.any()


@given(
    st.lists(st.tuples(*[st.floats(-900, 900, width=32)] * 4), min_size=1, max_size=5),
    st.integers(0, 9),
)
def test_a_mean_lies_between_the_least_and_the_greatest(
    windows: list[tuple[float, ...]], seed: int
) -> None:
    values = np.random.default_rng(seed).random((12, 16)).astype(np.float32)

    found = means(values, np.array(windows, np.float32), FIELD)

    assert (found >= 0).all()
    assert (found <= values.max() + 1e-5).all()
