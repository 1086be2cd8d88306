"""The windows that a ROI may show next."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.acting.looked import followed, nothing_looked
from operators.acting.windows import FACTS, PAIR, PLACE, TRACK, appearance, candidates, facts
from pipeline.boxes import centres, covered
from tests.operators.acting.samples import FIELD, context, tracks

WORKPLACE = 0.2, 0.36667, 0.8, 0.76667
NEAR, BESIDE, FAR = [200, 200, 220, 220], [260, 240, 290, 260], [500, 400, 520, 420]


def test_tracks_that_one_window_shows_together_have_one_between_them() -> None:
    found = candidates(tracks([NEAR, BESIDE, FAR]), WORKPLACE)

    assert [int((found.kinds == kind).sum()) for kind in (TRACK, PAIR, PLACE)] == [3, 1, 6]
    between = found.windows[found.kinds == PAIR][0]
    assert (covered(np.array([NEAR, BESIDE], np.float32), between) == 1).all()


def test_places_cover_the_workplace() -> None:
    found = candidates(tracks([]), WORKPLACE).windows
    left, top, right, bottom = np.array(WORKPLACE) * (640, 480, 640, 480)

    for x in np.linspace(left + 1, right - 1, 30):
        for y in np.linspace(top + 1, bottom - 1, 20):
            inside = (found[:, :2] <= (x, y)).all(1) & (found[:, 2:] >= (x, y)).all(1)
            assert inside.any()


@given(
    st.lists(
        st.tuples(*[st.floats(-2000, 2000, width=32)] * 2, *[st.floats(0, 900, width=32)] * 2),
        max_size=30,
    )
)
def test_windows_lie_in_the_field_and_their_facts_are_finite(
    given_boxes: list[tuple[float, ...]],
) -> None:
    subject = tracks([[x, y, x + w, y + h] for x, y, w, h in given_boxes])
    found = candidates(subject, WORKPLACE)
    looked = followed(nothing_looked(), np.asarray(context().pixels), 6)

    known = facts(subject, looked, found, 5)

    assert (found.windows[:, :2] >= 0).all()
    assert (found.windows[:, 2:] <= (640, 480)).all()
    assert (found.windows[:, 2:] - found.windows[:, :2] == (160, 120)).all()
    assert known.shape == (len(found.windows), FACTS)
    assert np.isfinite(known).all()
    assert len(found.windows) <= 48


def test_a_pair_looks_like_the_mean_of_both() -> None:
    subject = tracks([NEAR, BESIDE])
    subject.features[0], subject.features[1] = 1, 3
    found = candidates(subject, WORKPLACE)

    looks = appearance(subject, found)

    assert looks[:3].tolist() == [[1, 1], [3, 3], [2, 2]]
    assert not looks[3:].any()
    assert centres(found.windows)[2].tolist() == [242.0, 230.0]
    assert FIELD.roi_width_px == 160
