"""Tiles cover a picture, each place is owned once, and what changed is looked at first."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency.tiles import Changes, grid, part_around

TILE = (480, 288)
SIZE = (1000, 600)


def picture(seed: int = 1) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.integers(60, 90, (SIZE[1], SIZE[0], 3)), np.uint8)


def due(changes: Changes, now: NDArray[np.uint8], most: int, refresh: int) -> list[int]:
    changes.compare(now)
    return changes.due(most, refresh)


def looked_at_all() -> Changes:
    changes = Changes(grid(*SIZE, TILE, 48), levels=12)
    for tile in due(changes, picture(), 100, 50):
        changes.looked_at_tile(tile)
    return changes


@given(st.integers(1, 3000), st.integers(1, 2000), st.integers(0, 100))
@settings(max_examples=60, deadline=None)
def test_each_place_is_owned_by_one_tile_that_shows_it(width: int, height: int, ov: int) -> None:
    tiles = grid(width, height, TILE, ov)

    owned = (tiles.cores[:, 2:] - tiles.cores[:, :2]).prod(1)
    assert owned.sum() == width * height
    assert (tiles.cores[:, :2] >= tiles.windows[:, :2]).all()
    assert (tiles.cores[:, 2:] <= tiles.windows[:, 2:]).all()
    sides = tiles.windows[:, 2:] - tiles.windows[:, :2]
    assert (sides == np.minimum(TILE, (width, height))).all()


@given(st.integers(481, 3000), st.integers(8, 96))
@settings(max_examples=60, deadline=None)
def test_neighbours_overlap_by_what_is_asked_for(width: int, overlap: int) -> None:
    windows = grid(width, 288, TILE, overlap).windows

    assert (windows[:-1, 2] - windows[1:, 0] >= overlap).all()


def test_what_was_never_seen_is_looked_at_first_and_then_nothing_unless_it_changes() -> None:
    changes = Changes(grid(*SIZE, TILE, 48), levels=12)

    first = due(changes, picture(), 4, 50)
    for tile in first:
        changes.looked_at_tile(tile)
    second = due(changes, picture(), 100, 50)
    for tile in second:
        changes.looked_at_tile(tile)

    assert len(first) == 4
    assert not set(first) & set(second)
    assert sorted(first + second) == list(range(9))
    assert due(changes, picture(), 100, 50) == []


def test_a_tile_is_due_where_something_moved() -> None:
    changes = looked_at_all()
    later = picture()
    later[20:40, 10:20] = 250

    assert due(changes, later, 100, 50) == [0]


def test_slow_motion_is_judged_by_what_the_tile_showed_when_it_was_looked_at() -> None:
    changes = looked_at_all()

    for brightness in range(2, 12, 2):  # each step is less than the noise
        assert due(changes, picture() + np.uint8(brightness), 100, 50) == []

    assert len(due(changes, picture() + np.uint8(14), 100, 50)) == 9


def test_noise_is_no_change() -> None:
    assert due(looked_at_all(), picture(seed=2), 100, 50) == []


def test_a_tile_that_changes_little_has_its_turn_beside_one_that_changes_much() -> None:
    changes = looked_at_all()
    turns = []
    for k in range(40):
        now = picture()
        now[400:600, 600:1000] = 90 + 40 * (k % 2) + 60  # the last tile, all of it, always
        now[20:24, 10 : 14 + 4 * (k % 2)] = 250  # the first, a little
        first = due(changes, now, 1, 1000)
        for tile in first:
            changes.looked_at_tile(tile)
        turns += first

    assert 0 in turns
    assert turns.count(8) > turns.count(0)


def test_a_tile_without_change_is_looked_at_again_after_a_while() -> None:
    changes = looked_at_all()

    waited = [due(changes, picture(), 100, 5) for _ in range(5)]

    assert [len(tiles) for tiles in waited] == [0, 0, 0, 0, 9]


sides = st.integers(1, 3000)


@given(
    st.tuples(sides, sides), st.tuples(sides, sides), st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.sampled_from([(480, 288), (384, 224), (64, 64), (32, 32)]), st.integers(0, 256),
)  # fmt: skip
@settings(max_examples=200, deadline=None)
def test_the_tile_at_a_roi_is_within_the_picture_and_owns_the_middle_of_the_roi(
    size: tuple[int, int], wide: tuple[int, int], at: tuple[float, float],
    tile: tuple[int, int], overlap: int,
) -> None:  # fmt: skip
    roi_size = np.minimum(wide, size)
    begin = np.array(at) * (np.array(size) - roi_size)
    roi = np.concatenate([begin, begin + roi_size]).astype(np.float32)

    window, core = part_around(roi, size, tile, overlap)

    assert (window[2:] - window[:2] == np.minimum(tile, size)).all()
    assert (window[:2] >= 0).all()
    assert (window[2:] <= size).all()
    assert (core[:2] >= window[:2]).all()
    assert (core[2:] <= window[2:]).all()
    middle = (roi[:2] + roi[2:]) / 2
    inside = (core[:2] <= middle) & (middle < core[2:])
    at_border = (roi[:2] < 0.5) ^ (roi[2:] > np.array(size) - 0.5)
    assert (inside | at_border).all()


def test_where_a_roi_ends_with_the_picture_so_does_its_tile() -> None:
    corners = [(0, 0, 480, 270), (1440, 810, 1920, 1080)]

    found = [
        part_around(np.array(roi, np.float32), (1920, 1080), (384, 224), 48) for roi in corners
    ]

    assert [core.tolist() for _, core in found] == [[0, 0, 360, 200], [1560, 880, 1920, 1080]]


def test_a_roi_of_the_whole_picture_has_its_tile_in_the_middle() -> None:
    window, _ = part_around(np.array([0, 0, 1920, 1080], np.float32), (1920, 1080), (384, 224), 48)

    assert window.tolist() == [768, 416, 1152, 640]


def test_what_was_looked_at_beside_the_tiles_is_no_change() -> None:
    changes = looked_at_all()
    later = picture()
    later[20:40, 10:20] = later[500:520, 900:920] = 250

    changes.compare(later)
    changes.looked_at(np.array([0, 0, 100, 100]))

    assert changes.due(100, 50) == [8]
