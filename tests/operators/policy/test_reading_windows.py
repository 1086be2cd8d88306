"""The window of a text shows it, and of all windows between two texts what is worth most."""

import tracemalloc
from collections.abc import Sequence

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from operators.policy.reading.windows import MARGIN_PX, NEARER, WHOLE, around
from pipeline import Geometry
from pipeline.boxes import Array

FIELD, ROI = (1280, 720), (320, 180)
GEOMETRY = Geometry(
    width_px=FIELD[0], height_px=FIELD[1], roi_width_px=ROI[0], roi_height_px=ROI[1]
)
Text = tuple[int, int, int, int, int]  # middle, width and height in pixels; worth in tenths
TEXTS = st.lists(
    st.tuples(
        *(st.integers(-20, side + 20) for side in FIELD),
        *(st.integers(1, side + 40) for side in ROI),
        st.integers(0, 10),
    ),
    min_size=1,
    max_size=9,
)


def arrays(texts: Sequence[Text]) -> tuple[Array, Array]:
    middle = np.array([text[:2] for text in texts], np.float32)
    half = np.array([text[2:4] for text in texts], np.float32) / 2
    worth = np.array([text[4] for text in texts], np.float32) / 10
    return np.concatenate([middle - half, middle + half], axis=1), worth


def shown(place: Array, box: Array) -> bool:
    """Return whether the window at a place shows a box and its margin, as far as in the field."""
    grown = np.clip(
        box + MARGIN_PX * np.array([-1, -1, 1, 1], np.float32), 0, np.tile(FIELD, 2)
    ).astype(np.float32)
    half = np.array(ROI, np.float32) / 2
    low, high = np.maximum(grown[:2], place - half), np.minimum(grown[2:], place + half)
    common = np.maximum(high - low, 0).prod()
    return bool(common >= WHOLE * max((grown[2:] - grown[:2]).prod(), 1e-9))


def between(a: Array, b: Array) -> Array:
    """Return the middle of the window between two texts, inside the field."""
    half = np.array(ROI, np.float32) / 2
    middle = ((a[:2] + a[2:]) / 2 + (b[:2] + b[2:]) / 2) / 2
    return np.clip(middle, half, np.array(FIELD, np.float32) - half)


# further apart than a window is high, but at the field's edge one shows both
EDGE: list[Text] = [(0, 10, 1, 1, 0), (0, -10, 1, 11, 10), (0, 171, 1, 1, 0)]


@example(texts=EDGE)
@given(texts=TEXTS)
def test_no_window_between_two_texts_is_worth_more(texts: list[Text]) -> None:
    boxes, worth = arrays(texts)

    places, shows = around(boxes, worth, GEOMETRY)

    for row, box in enumerate(boxes):
        assert shows[row].tolist() == [shown(places[row], each) for each in boxes]
        others = [between(box, each) for each in boxes]
        fitting = [place for place in others if shown(place, box)]
        if not fitting:  # larger than a window
            assert (places[row] == between(box, box)).all()
            continue
        assert shows[row, row]
        worths = [
            sum(worth[k] for k, each in enumerate(boxes) if shown(place, each)) for place in fitting
        ]
        assert shows[row] @ worth >= max(worths) - 2 * NEARER


def test_without_texts_there_is_no_window() -> None:
    places, shows = around(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), GEOMETRY)

    assert (places.shape, shows.shape) == ((0, 2), (0, 0))


def test_many_texts_take_little_memory() -> None:
    rng = np.random.default_rng(0)
    middle = rng.uniform([500, 250], [780, 400], (300, 2)).astype(np.float32)
    boxes = np.concatenate([middle - 6, middle + 6], 1)

    tracemalloc.start()
    places, shows = around(boxes, rng.random(300).astype(np.float32), GEOMETRY)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert most < 64 * 2**20
    assert shows.diagonal().all()
    assert all(shown(places[k], boxes[j]) == shows[k, j] for k in range(0, 300, 50) for j in (0, 9))
