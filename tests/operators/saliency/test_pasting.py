"""What is copied into a still has a tight box, the class that it had, and a plausible place."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency.augment import cut
from operators.saliency.crops import (
    crop,
)
from operators.saliency.example import CONTEXT_PX, Example
from operators.saliency.pasted_balls import BALL_COVER
from operators.saliency.pasting import (
    PERSON_COVER,
    Bank,
    cutout,
    end_of_grass,
    paste_at_boards,
    paste_crowd,
    paste_people,
    without_covered,
)
from pipeline.boxes import iou
from tests.operators.saliency.lawn import PLAYER, REFEREE, still

SEEDS = st.integers(0, 2**32 - 1)


def test_a_copied_person_has_a_tight_box_and_the_class_it_had(bank: Bank) -> None:
    target = crop(still(), np.random.default_rng(5))

    found = [paste_people(target, bank, np.random.default_rng(seed)) for seed in range(40)]

    more = [f for f in found if len(f.labels) > len(target.labels)]
    assert more
    assert {int(label) for f in more for label in f.labels} >= {PLAYER, REFEREE}
    for example in more:
        box = example.boxes[len(target.labels)]
        left, top, right, bottom = box.astype(int)
        red = is_red(example.picture[top:bottom, left:right])
        assert red.mean() > 0.4
        assert (box >= 0).all()
        assert (box[2:] <= CONTEXT_PX).all()


def test_people_of_a_crowd_cover_one_another(bank: Bank) -> None:
    target = crop(still(), np.random.default_rng(5))

    found = [paste_crowd(target, bank, np.random.default_rng(seed)) for seed in range(60)]

    more = [f for f in found if len(f.labels) > len(target.labels)]
    assert 5 < len(more) < 40
    people = np.concatenate([f.boxes[len(target.labels) :] for f in more])
    tall = target.boxes[0, 3] - target.boxes[0, 1]
    assert np.abs((people[:, 3] - people[:, 1]) / tall - 1).max() < 0.3
    covered = [iou(f.boxes[-1:], f.boxes[:-1]).max() for f in more]
    assert np.mean(np.array(covered) > 0.1) > 0.3


def test_who_is_hardly_seen_behind_others_does_not_count() -> None:
    example = still()
    behind = example.boxes[0]
    beside = behind + np.array([40, 0, 40, 0], np.float32)
    crowd = replace(
        example,
        boxes=np.vstack([example.boxes, behind + 1, beside]),
        labels=np.append(example.labels, [PLAYER, PLAYER]),
        ignored=np.append(example.ignored, [False, False]),
    )

    found = without_covered(crowd, len(example.labels))

    assert found.ignored.tolist() == [True] + [False] * 11


def test_people_at_the_boards_stand_where_the_grass_ends(bank: Bank) -> None:
    target = crop(still(), np.random.default_rng(5))
    boards = 60
    target.picture[:boards] = (90, 60, 120)
    far = target.boxes[target.labels == PLAYER]
    tall = float(far[0, 3] - far[0, 1])

    found = [paste_at_boards(target, bank, np.random.default_rng(seed)) for seed in range(40)]

    more = np.concatenate([f.boxes[len(target.labels) :] for f in found])
    assert len(more) > 5
    assert {int(n) for f in found for n in f.labels[len(target.labels) :]} == {PLAYER, REFEREE}
    assert (np.abs(more[:, 3] - boards - 0.2 * tall) < 0.3 * tall + 2).all()
    assert (more[:, 3] - more[:, 1] < 1.15 * tall + 2).all()


@given(st.integers(0, 99), st.integers(0, 9))
def test_the_grass_ends_above_lines_and_feet_on_it(end: int, gap: int) -> None:
    column = np.zeros(100, np.bool_)
    column[end:] = True
    inner = slice(end + 1, min(end + 1 + gap, 99))
    column[inner] = False

    assert end_of_grass(column, 30.0) == end
    column[:] = False
    assert end_of_grass(column, 30.0) == 100


def test_a_picture_without_people_or_grass_gets_nobody_at_its_boards(bank: Bank) -> None:
    target = crop(still(), np.random.default_rng(5))
    nobody = cut(replace(target, boxes=target.boxes + 4000), *CONTEXT_PX)
    grey = replace(target, picture=np.full_like(target.picture, 90))

    for example in (nobody, grey):
        found = [paste_at_boards(example, bank, np.random.default_rng(k)) for k in range(20)]
        assert {len(f.labels) for f in found} == {len(example.labels)}


def test_what_does_not_stand_out_is_not_copied(bank: Bank) -> None:
    example = bank.still(0)
    dull = Example(
        picture=np.full_like(example.picture, 90), boxes=example.boxes, labels=example.labels,
        ignored=example.ignored,
    )  # fmt: skip

    assert cutout(example, 1, 0.5, PERSON_COVER) is not None
    assert cutout(example, 0, 0.5, BALL_COVER) is not None
    assert cutout(dull, 1, 0.5, PERSON_COVER) is None
    assert cutout(example, 1, 2.0, PERSON_COVER) is None  # enlarged, it would be blurred


def is_red(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(picture[..., 0].astype(int) - picture[..., 1] > 60)
