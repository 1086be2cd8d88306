"""Crops of stills have the context's size, boxes inside, and people of the heights of the loop."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency import crops
from operators.saliency.augment import MOST_BALL_PX
from operators.saliency.crops import (
    crop,
    mirrored,
    painted,
    recoloured_kits,
    recoloured_referees,
    recoloured_team,
)
from operators.saliency.example import ANYONE, CONTEXT_PX, Example, resized
from operators.saliency.pasting import (
    Bank,
)
from tests.operators.saliency.lawn import BALL, PLAYER, REFEREE, still

SEEDS = st.integers(0, 2**32 - 1)


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


@pytest.mark.parametrize(("roi", "most_px"), [(False, MOST_BALL_PX), (True, crops.ROI_BALL_PX)])
def test_every_still_is_offered_a_corner_before_balls_are_drawn(
    roi: bool, most_px: float, monkeypatch: pytest.MonkeyPatch, bank: Bank
) -> None:
    done: list[tuple[str, float]] = []

    def noted(name: str, example: Example, _: np.random.Generator, most_ball_px: float) -> Example:
        done.append((name, most_ball_px))
        return example

    for name in ("with_corner", "paste"):
        monkeypatch.setattr(crops, name, partial(noted, name))

    crops.augmented(bank.still(0), bank, np.random.default_rng(1), roi=roi)

    assert done == [("with_corner", most_px), ("paste", most_px)]


@given(SEEDS, st.sampled_from([(480, 270), (736, 414), (200, 113)]))
@settings(max_examples=20, deadline=None)
def test_boxes_go_with_a_picture_of_another_size(seed: int, size_px: tuple[int, int]) -> None:
    example = crop(still(), np.random.default_rng(seed))

    found = resized(example, size_px)

    assert found.picture.shape == (size_px[1], size_px[0], 3)
    shares = np.array([*size_px, *size_px]), np.array([*CONTEXT_PX, *CONTEXT_PX])
    assert np.allclose(found.boxes / shares[0], example.boxes / shares[1], atol=1e-5)
    assert np.array_equal(found.labels, example.labels)
