"""Augmented training pictures keep correct boxes and labels."""

import numpy as np
import pytest

from operators.saliency.augment import augment, clutter, move, paste
from operators.saliency.example import BALL, NAMES, Example


def grass_with_player(seed: int) -> Example:
    """Return a noisy green picture with one bright red rectangle, which is the player."""
    rng = np.random.default_rng(seed)
    picture = rng.integers(40, 60, (270, 480, 3), np.uint8)
    left, top = int(rng.integers(40, 400)), int(rng.integers(40, 180))
    picture[top : top + 50, left : left + 22] = (255, 0, 0)
    return Example(
        picture=picture,
        boxes=np.array([[left, top, left + 22, top + 50]], np.float32),
        labels=np.zeros(1, np.int64),
        ignored=np.zeros(1, np.bool_),
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_moved_box_still_frames_its_object(seed: int) -> None:
    moved = move(grass_with_player(seed), np.random.default_rng(seed))

    red = (moved.picture[..., 0] > 150) & (moved.picture[..., 1] < 100)
    for left, top, right, bottom in moved.boxes[~moved.ignored].round().astype(int):
        inside = red[max(top, 0) : bottom, max(left, 0) : right]
        assert inside.mean() > 0.85


def test_the_light_of_a_moved_object_stays_in_the_middle_of_its_box() -> None:
    picture = np.zeros((270, 480, 3), np.uint8)
    picture[120:140, 230:250] = 255
    box = np.array([[230, 120, 250, 140]], np.float32)
    item = Example(
        picture=picture, boxes=box, labels=np.zeros(1, np.int64), ignored=np.zeros(1, np.bool_)
    )
    apart = []

    for seed in range(60):
        moved = move(item, np.random.default_rng(seed))
        middle = (moved.boxes[0, :2] + moved.boxes[0, 2:]) / 2
        left, top = (middle - 24).astype(int)
        part = np.s_[top : top + 48, left : left + 48]
        light = moved.picture[part].astype(float).sum(2)
        if light.shape == (48, 48) and not light[[0, -1]].any() and not light[:, [0, -1]].any():
            y, x = np.mgrid[part] + 0.5
            seen = np.array([(light * x).sum(), (light * y).sum()]) / light.sum()
            apart.append(np.abs(seen - middle).max())

    assert len(apart) > 30  # the others are at the edge of the picture
    assert max(apart) < 0.2  # OpenCV places in steps of a 32nd pixel


@pytest.mark.parametrize("seed", range(20))
def test_pasted_balls_are_labelled_where_the_picture_changed(seed: int) -> None:
    plain = grass_with_player(seed)
    pasted = paste(plain, np.random.default_rng(seed))

    changed = (pasted.picture.astype(int) - plain.picture).any(2)
    balls = pasted.labels == NAMES.index(BALL)
    assert len(pasted.labels) == 1 + balls.sum()
    for left, top, right, bottom in pasted.boxes[balls]:
        middle = changed[int((top + bottom) / 2), int((left + right) / 2)]
        assert middle
        assert 1.0 < right - left < 40


def test_the_same_seed_gives_the_same_picture_and_another_seed_a_different_one() -> None:
    first, again, other = (
        augment(grass_with_player(1), np.random.default_rng(seed)) for seed in (5, 5, 6)
    )

    assert np.array_equal(first.picture, again.picture)
    assert np.array_equal(first.boxes, again.boxes)
    assert not np.array_equal(first.picture, other.picture)


@pytest.mark.parametrize("seed", range(20))
def test_boxes_stay_inside_the_picture_and_keep_their_order(seed: int) -> None:
    changed = augment(grass_with_player(seed), np.random.default_rng(seed))

    assert (changed.boxes[:, :2] >= 0).all()
    assert (changed.boxes[:, 2:] <= (480, 270)).all()
    assert (changed.boxes[:, 2:] > changed.boxes[:, :2]).all()
    assert len(changed.boxes) == len(changed.labels) == len(changed.ignored)


@pytest.mark.parametrize("seed", range(20))
def test_clutter_changes_every_picture_except_where_a_person_is(seed: int) -> None:
    example = grass_with_player(seed)
    left, top, right, bottom = np.round(example.boxes[0]).astype(int)
    person = np.s_[top:bottom, left:right]

    changed = clutter(example, np.random.default_rng(seed))

    assert np.array_equal(changed[person], example.picture[person])
    assert not np.array_equal(changed, example.picture)
