"""A training picture's frame before: what moved is new where it is, and gone where it was."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency import movement
from operators.saliency.augment import augment, move, paste
from operators.saliency.crops import mirrored
from operators.saliency.example import CONTEXT_PX, NAMES, Example, resized
from operators.saliency.movement import (
    ball_movement,
    frame_before,
    in_motion,
    roughened,
    with_motion,
)
from operators.saliency.render import packed, unpacked

SEEDS = st.integers(0, 2**20)
BALL = NAMES.index("ball")


def scene() -> Example:
    """One bright person and one ball on dark grass."""
    picture = np.full((270, 480, 3), 60, np.uint8)
    picture[100:140, 200:214] = 200
    picture[180:184, 300:304] = 240
    return Example(
        picture=picture,
        boxes=np.array([[200, 100, 214, 140], [300, 180, 304, 184]], np.float32),
        labels=np.array([0, BALL]),
        ignored=np.zeros(2, np.bool_),
    )


def still() -> Example:
    """The same, and nothing moved."""
    return replace(scene(), difference=np.zeros((270, 480), np.float32))


@given(st.integers(-9, 9), st.integers(-9, 9))
def test_a_thing_laid_into_a_picture_leaves_its_old_place(x: int, y: int) -> None:
    before = np.full((60, 80, 3), 50, np.uint8)
    after = before.copy()
    after[30:34, 40:44] = 250

    found = with_motion(np.zeros((60, 80), np.float32), before, after, np.array([x, y], np.float32))

    wanted = np.zeros((60, 80), np.float32)
    wanted[30:34, 40:44] += 200
    wanted[30 - y : 34 - y, 40 - x : 44 - x] -= 200
    assert found is not None
    assert np.allclose(found, wanted, atol=1)


def test_without_a_frame_before_nothing_is_known_to_move() -> None:
    picture = scene().picture

    assert with_motion(None, picture, picture, np.ones(2, np.float32)) is None
    assert roughened(None, np.random.default_rng(1)) is None
    assert frame_before(scene()) is None


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_people_of_a_still_move_and_most_pictures_have_a_frame_before(seed: int) -> None:
    found = in_motion(scene(), np.random.default_rng(seed))

    if found.difference is None:
        return
    assert np.abs(found.difference[98:142, 196:218]).max() > 5
    assert np.array_equal(found.picture, scene().picture)


def test_one_picture_of_seven_has_no_frame_before() -> None:
    known = [
        in_motion(scene(), np.random.default_rng(k)).difference is not None for k in range(400)
    ]

    assert np.mean(known) == pytest.approx(movement.KNOWN_SHARE, abs=0.05)


def test_a_smeared_ball_moves_the_way_it_is_smeared_and_farther() -> None:
    for seed in range(60):
        smear, shift = ball_movement(4.0, np.random.default_rng(seed))
        if smear.any():
            assert np.linalg.norm(shift) >= np.linalg.norm(smear)
            assert smear[0] * shift[1] == pytest.approx(smear[1] * shift[0], abs=1e-4)


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_pasted_balls_change_the_difference_only_where_there_is_one(seed: int) -> None:
    without = paste(scene(), np.random.default_rng(seed))
    found = paste(still(), np.random.default_rng(seed))

    assert without.difference is None
    assert np.array_equal(without.picture, found.picture)
    assert found.difference is not None
    new = np.argwhere(np.abs(found.picture.astype(int) - scene().picture).max(2) > 0)
    far = np.ones(found.difference.shape, np.bool_)
    for y, x in new:  # what moves was at most so far away
        far[max(y - 60, 0) : y + 61, max(x - 60, 0) : x + 61] = False
    assert not found.difference[far].any()


def test_most_pasted_balls_that_move_are_new_where_they_are_and_gone_where_they_were() -> None:
    found = [paste(still(), np.random.default_rng(seed)).difference for seed in range(60)]

    lighter = [float(d.max()) for d in found if d is not None]
    darker = [float(d.min()) for d in found if d is not None]
    assert np.mean(np.array(lighter) > 40) > 0.4
    assert np.mean(np.array(darker) < -40) > 0.4
    assert min(lighter) == 0


@pytest.mark.parametrize("size_px", [(270, 40), (30, 400), (20, 20), (3, 3)])
def test_pictures_of_any_size_have_a_frame_before(size_px: tuple[int, int]) -> None:
    small = replace(
        scene(), picture=np.full((size_px[1], size_px[0], 3), 90, np.uint8),
        boxes=np.zeros((0, 4), np.float32), labels=np.zeros(0, np.int64),
        ignored=np.zeros(0, np.bool_),
    )  # fmt: skip

    for seed in range(20):
        found = in_motion(small, np.random.default_rng(seed)).difference
        assert found is None or found.shape == size_px[::-1]


def test_a_difference_goes_with_the_picture() -> None:
    example = still()
    assert example.difference is not None
    example.difference[100:140, 200:214] = 90

    for found in (
        mirrored(example),
        resized(example, (960, 540)),
        *(move(example, np.random.default_rng(seed)) for seed in range(8)),
    ):
        assert found.difference is not None
        assert found.difference.shape == found.picture.shape[:2]
        for left, top, right, bottom in np.round(found.boxes[found.labels == 0]).astype(int):
            assert (found.difference[top + 3 : bottom - 3, left + 3 : right - 3] > 80).all()
            assert np.abs(found.difference).sum() < 1.3 * 90 * (bottom - top) * (right - left)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_an_augmented_picture_keeps_its_frame_before(seed: int) -> None:
    found = augment(still(), np.random.default_rng(seed))

    assert found.difference is not None
    assert found.difference.shape == CONTEXT_PX[::-1]


@given(st.integers(-255, 255))
def test_a_difference_is_kept_beside_its_picture_to_one_level(level: int) -> None:
    picture = scene().picture

    same, found = unpacked(packed(picture, np.full((270, 480), level, np.float32)))

    assert np.array_equal(same, picture)
    assert found is not None
    assert np.abs(found - level).max() <= 1.5


def test_pictures_kept_without_a_difference_have_none() -> None:
    same, found = unpacked(scene().picture)

    assert np.array_equal(same, scene().picture)
    assert found is None


def test_the_frame_before_lacks_what_is_new() -> None:
    example = still()
    assert example.difference is not None
    example.difference[180:184, 300:304] = 180

    before = frame_before(example)

    assert before is not None
    assert before[182, 302] == 60
    assert before[120, 205] == 200
