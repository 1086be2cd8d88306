"""Crops of stills have the context's size, boxes inside, and people of the heights of the loop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency import crops
from operators.saliency.augment import cut
from operators.saliency.crops import (
    crop,
    mirrored,
    painted,
    recoloured_kits,
    recoloured_referees,
    recoloured_team,
)
from operators.saliency.example import ANYONE, CONTEXT_PX, NAMES, Example, resized
from operators.saliency.pasting import (
    BALL_COVER,
    PERSON_COVER,
    Bank,
    Cutout,
    at_hands,
    cutout,
    end_of_grass,
    half_covered,
    paste_at_boards,
    paste_crowd,
    paste_people,
    smeared,
    without_covered,
)
from operators.saliency.stills import stills
from pipeline.boxes import iou
from tests.operators.training.labelled_stills import match_of_stills

SEEDS = st.integers(0, 2**32 - 1)
BALL, PLAYER, REFEREE = (NAMES.index(name) for name in ("ball", "player", "referee"))


def still(tall_px: float = 54.0, size: tuple[int, int] = (1920, 1080)) -> Example:
    """People in a row and a ball, on grass."""
    width, height = size
    picture = np.full((height, width, 3), (60, 130, 50), np.uint8)
    x = np.linspace(0.1, 0.9, 9)[:, None] * width
    people = np.hstack([x, x * 0 + height / 2, x + tall_px / 2, x * 0 + height / 2 + tall_px])
    boxes = np.vstack([people, [[width / 3, height / 3, width / 3 + 6, height / 3 + 6]]])
    return Example(
        picture=picture, boxes=boxes.astype(np.float32), labels=np.array([PLAYER] * 9 + [BALL]),
        ignored=np.zeros(10, np.bool_),
    )  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.sampled_from([(54.0, (1920, 1080)), (17.0, (2160, 1080)), (40.0, (500, 300))]))
def test_a_crop_has_the_size_of_the_context_and_boxes_inside(
    seed: int, kind: tuple[float, tuple[int, int]]
) -> None:
    found = crop(still(*kind), np.random.default_rng(seed))

    assert found.picture.shape == (CONTEXT_PX[1], CONTEXT_PX[0], 3)
    assert (found.boxes >= 0).all()
    assert (found.boxes[:, 2:] <= CONTEXT_PX).all()
    assert len(found.boxes) == len(found.labels) == len(found.ignored)


@pytest.mark.parametrize(("tall", "size"), [(54.0, (1920, 1080)), (17.0, (2160, 1080))])
def test_people_are_as_tall_as_the_loop_shows_them(tall: float, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    crops = [crop(still(tall, size), rng) for _ in range(60)]

    whole = [c.boxes[(c.labels == PLAYER) & ~c.ignored] for c in crops]
    heights = np.concatenate([b[:, 3] - b[:, 1] for b in whole])

    assert np.quantile(heights, 0.05) > 7
    assert heights.max() < 66
    # of a camera that shows the whole pitch, the context itself is what a tile shows
    assert np.mean((heights > 10) & (heights < 24)) > 0.4


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_mirroring_twice_changes_nothing(seed: int) -> None:
    example = crop(still(), np.random.default_rng(seed))

    again = mirrored(mirrored(example))

    assert np.array_equal(again.picture, example.picture)
    assert np.allclose(again.boxes, example.boxes, atol=1e-3)


@pytest.mark.parametrize("dressed", ["players", "referees"])
def test_new_kits_leave_grass_and_all_others_as_they_were(dressed: str) -> None:
    example = still()
    labels = example.labels.copy()
    labels[0], labels[1] = REFEREE, ANYONE
    for box in example.boxes[:9].astype(int):
        example.picture[box[1] + 4 : box[3] - 4, box[0] + 4 : box[2] - 4] = (200, 30, 40)
    painted = Example(
        picture=example.picture, boxes=example.boxes, labels=labels, ignored=example.ignored
    )

    recolour = recoloured_kits if dressed == "players" else recoloured_referees
    found = recolour(painted, np.random.default_rng(3))

    changed = (found.picture != example.picture).any(2)
    for row, box in enumerate(example.boxes[:9].astype(int)):
        inside = changed[box[1] + 5 : box[3] - 5, box[0] + 5 : box[2] - 5]
        assert inside.all() if (row > 0) == (dressed == "players") else not inside.any()
    grass = (example.picture == (60, 130, 50)).all(2)
    assert not changed[grass].any()


@pytest.mark.parametrize("seed", range(6))
def test_black_shirts_are_painted_in_one_bright_colour(seed: int) -> None:
    example = still()
    rows = [box for box in example.boxes[:9].astype(int)]
    for left, top, right, bottom in rows:
        example.picture[top + 4 : bottom - 4, left + 4 : right - 4] = (25, 22, 24)
    black = Example(
        picture=example.picture, boxes=example.boxes, ignored=example.ignored,
        labels=np.array([REFEREE] * 2 + [PLAYER] * 7 + [BALL]),
    )  # fmt: skip

    referees = [box.tolist() for box in rows[:2]]
    found = painted(black, referees, np.random.default_rng(seed))

    shirts = [
        found.picture[top + 5 : top + 20, left + 5 : right - 5] for left, top, right, _ in rows
    ]
    colours = {tuple(pixel) for shirt in shirts[:2] for pixel in shirt.reshape(-1, 3).tolist()}
    assert len(colours) == 1
    assert max(colours.pop()) > 110
    assert all((shirt == (25, 22, 24)).all() for shirt in shirts[2:])
    assert (found.picture[0] == (60, 130, 50)).all()


def dressed(shirts: list[tuple[int, int, int]]) -> Example:
    """The still, with players in these shirts and a referee in black as the last of nine."""
    example = still()
    for box, shirt in zip(example.boxes[:9].astype(int), [*shirts, (20, 20, 20)], strict=True):
        example.picture[box[1] + 4 : box[3] - 4, box[0] + 4 : box[2] - 4] = shirt
    labels = np.array([PLAYER] * 8 + [REFEREE, BALL])
    return replace(example, labels=labels)


def changed_shirts(example: Example, found: Example) -> set[int]:
    """Rows of people all of whose shirt has changed; nobody's has in part."""
    changed = (found.picture != example.picture).any(2)
    rows = set()
    for row, box in enumerate(example.boxes[:9].astype(int)):
        shirt = changed[box[1] + 5 : box[1] + 20, box[0] + 5 : box[2] - 5]
        assert shirt.all() or not shirt.any()
        rows |= {row} if shirt.any() else set()
    return rows


def test_one_team_gets_a_new_kit_and_the_other_and_the_referee_keep_theirs() -> None:
    example = dressed([(200, 30, 40), (40, 40, 150)] * 4)
    found = [recoloured_team(example, np.random.default_rng(seed)) for seed in range(20)]

    teams = [changed_shirts(example, item) for item in found]

    assert {tuple(sorted(team)) for team in teams} == {(0, 2, 4, 6), (1, 3, 5, 7)}
    left, top, right = example.boxes[0, :3].astype(int)
    shirts = [item.picture[top + 5 : top + 20, left + 5 : right - 5] for item in found]
    assert any(shirt.max() < 90 for shirt in shirts)  # in black
    assert any(shirt.max() > 110 and shirt[..., 0].max() != 200 for shirt in shirts)


@pytest.mark.parametrize(
    "shirts",
    [
        [(200, 30, 40)] * 8,
        [(200, 30, 40), (205, 35, 45)] * 4,
        [(200, 30, 40)] * 3 + [(40, 40, 150)] * 2 + [(60, 130, 50)] * 3,  # of three only grass
    ],
)
def test_without_two_teams_nobody_gets_a_new_kit(shirts: list[tuple[int, int, int]]) -> None:
    example = dressed(shirts)

    found = recoloured_team(example, np.random.default_rng(1))

    assert np.array_equal(found.picture, example.picture)


def test_somebody_of_whom_only_grass_is_seen_is_in_no_team() -> None:
    example = dressed([(200, 30, 40), (40, 40, 150)] * 3 + [(200, 30, 40), (60, 130, 50)])

    found = [recoloured_team(example, np.random.default_rng(seed)) for seed in range(20)]

    teams = {tuple(sorted(changed_shirts(example, item))) for item in found}
    assert teams == {(0, 2, 4, 6), (1, 3, 5)}


def test_a_still_is_shown_with_a_team_in_another_kit_in_three_of_ten(monkeypatch, bank: Bank):
    used: list[bool] = []
    monkeypatch.setattr(crops, "recoloured_team", lambda item, _: used.append(True) or item)

    for seed in range(60):
        crops.augmented(bank.still(0), bank, np.random.default_rng(seed))

    assert 8 < len(used) < 30


@given(SEEDS, st.sampled_from([(480, 270), (736, 414), (200, 113)]))
@settings(max_examples=20, deadline=None)
def test_boxes_go_with_a_picture_of_another_size(seed: int, size_px: tuple[int, int]) -> None:
    example = crop(still(), np.random.default_rng(seed))

    found = resized(example, size_px)

    assert found.picture.shape == (size_px[1], size_px[0], 3)
    shares = np.array([*size_px, *size_px]), np.array([*CONTEXT_PX, *CONTEXT_PX])
    assert np.allclose(found.boxes / shares[0], example.boxes / shares[1], atol=1e-5)
    assert np.array_equal(found.labels, example.labels)


@given(st.floats(0, 30), st.floats(0, 2 * np.pi))
@settings(max_examples=40, deadline=None)
def test_a_moving_object_is_as_much_light_over_a_longer_way(length: float, angle: float) -> None:
    disc = np.zeros((9, 9), np.float32)
    disc[2:7, 2:7] = 1
    ball = Cutout(picture=np.full((9, 9, 3), 240, np.uint8), alpha=disc)

    way = np.array([np.cos(angle), np.sin(angle)], np.float32)
    found = smeared(ball, np.float32(length) * way)

    assert found.alpha.sum() == pytest.approx(disc.sum(), rel=1e-3)
    assert (found.picture[found.alpha > 0.05] >= 239).all()
    rows, columns = np.nonzero(found.alpha > 1e-3)
    wide, tall = np.ptp(columns) + 1, np.ptp(rows) + 1
    assert wide == pytest.approx(5 + abs(length * np.cos(angle)), abs=2)
    assert tall == pytest.approx(5 + abs(length * np.sin(angle)), abs=2)


@pytest.fixture
def bank(tmp_path: Path) -> Bank:
    """One still with a ball, two players and a referee."""
    folder = stills(match_of_stills(tmp_path, "aa_1"))
    example = folder.example(folder.files[0])
    return Bank(count=1, still=lambda _: example)


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


@given(SEEDS)
def test_a_held_ball_is_at_somebodys_body_and_half_of_it_is_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    person = np.array([100, 50, 120, 110], np.float32)
    disc = np.pad(np.ones((7, 7), np.float32), 1)
    ball = Cutout(picture=np.full((9, 9, 3), 240, np.uint8), alpha=disc)

    x, y = at_hands(person, rng)
    found = half_covered(ball, rng)

    assert 97 <= x <= 123
    assert 62 <= y <= 92
    assert 0.35 * disc.sum() < found.alpha.sum() <= disc.sum()


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
