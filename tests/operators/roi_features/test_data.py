"""Training data of the encoder: true objects, and false candidates that show no whole object."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
from drivers.scenes.soccer import SoccerScene
from drivers.source import Annotations
from operators.roi_features.data import (
    BACKGROUND,
    CROP_PX,
    NOBODY,
    OTHERS,
    candidates,
    chosen,
    disturbed,
    false_candidates,
    load,
    moment,
    on_person,
    outstanding,
)
from operators.roi_features.model import CLASSES
from pipeline.boxes import intersections, iou

SIZE_PX = (960, 540)


def truth_of(*objects: tuple[str, float, tuple[float, float, float, float]]) -> Annotations:
    """Return objects 1, 2, …, each given as label, visible share and box."""
    return Annotations(
        boxes=np.array([o[2] for o in objects], np.float32).reshape(-1, 4),
        ids=np.arange(1, len(objects) + 1, dtype=np.int32),
        labels=tuple(o[0] for o in objects),
        visibility=np.array([o[1] for o in objects], np.float32),
    )


def grass(seed: int) -> np.ndarray:
    """Return a picture of a pitch without lines."""
    rng = np.random.default_rng(seed)
    return rng.integers((60, 110, 40), (80, 140, 60), (540, 960, 3)).astype(np.uint8)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_false_candidate_shows_a_ball_or_a_whole_person(seed: int) -> None:
    truth = truth_of(("ball", 1.0, (500, 300, 514, 314)), ("player", 1.0, (200, 200, 250, 330)))

    found = false_candidates(grass(seed), truth, 60, np.random.default_rng(seed))

    assert not intersections(truth.boxes[:1], found).any()
    assert iou(truth.boxes[1:], found).max() < 0.2


def test_false_candidates_are_placed_on_small_white_spots() -> None:
    picture = grass(3)
    picture[400:408, 700:708] = 240

    places = outstanding(picture, np.random.default_rng(3))

    assert (abs(places - (704, 404)) < 5).all()


def test_bright_parts_of_a_person_are_chosen_most_often() -> None:
    picture = np.zeros((540, 960, 3), np.uint8)
    picture[210:240, 200:240] = 250  # a tenth of the body
    rng = np.random.default_rng(3)

    places = np.array([on_person(picture, np.array([200, 200, 240, 400]), rng) for _ in range(300)])

    bright = (places[:, 1] >= 210) & (places[:, 1] < 240)
    assert 0.2 < bright.mean() < 0.5
    assert 0.2 < (places[:, 1] == 392).mean() < 0.4  # boots


def test_any_place_is_chosen_in_a_picture_without_bright_spots() -> None:
    assert outstanding(grass(4), np.random.default_rng(4)).std(0).min() > 50


def test_officials_are_chosen_before_players_and_hidden_people_never() -> None:
    box = (0.0, 0.0, 40.0, 100.0)
    truth = truth_of(
        ("player", 1.0, box), ("player", 0.1, box), ("main referee", 1.0, box), ("ball", 0.1, box)
    )

    people, balls = chosen(truth, np.random.default_rng(5), 8)

    assert people.tolist() == [2, 0]
    assert not len(balls)
    assert chosen(truth, np.random.default_rng(5), 1)[0].tolist() == [2]


def test_a_small_box_is_disturbed_more_than_a_large_one() -> None:
    boxes = np.array([[100, 100, 112, 112]] * 200 + [[100, 100, 160, 240]] * 200, np.float32)

    overlap = np.diag(iou(boxes, disturbed(boxes, np.random.default_rng(6))))

    assert overlap[:200].mean() < overlap[200:].mean()
    assert np.median(overlap) > 0.5


def test_a_moment_holds_people_ball_and_false_candidates() -> None:
    scene = SoccerScene(size_px=SIZE_PX, rate_hz=25.0, seed=7)

    found = moment(scene, 40, 7, np.random.default_rng(7))
    again = candidates(scene, 40, np.random.default_rng(7))

    assert found.pictures.shape == (len(found.kinds), CROP_PX, CROP_PX, 3)
    assert (found.kinds == BACKGROUND).sum() == OTHERS
    assert {CLASSES[kind] for kind in found.kinds} >= {"player", "ball", "background"}
    known = found.persons != NOBODY
    assert len(set(found.persons[known])) == known.sum() > 0
    assert np.array_equal(again.kinds, found.kinds)
    scene.close()


def test_rendered_crops_are_read_back_as_one(tmp_path: Path) -> None:
    scene = SoccerScene(size_px=SIZE_PX, rate_hz=25.0, seed=8)
    one = moment(scene, 10, 8, np.random.default_rng(8))
    for name in ("a", "b"):
        np.savez(tmp_path / f"{name}.npz", **vars(one))

    both = load([tmp_path / "a.npz", tmp_path / "b.npz"])

    assert np.array_equal(both.pictures, np.concatenate([one.pictures, one.pictures]))
    assert np.array_equal(both.persons, np.tile(one.persons, 2))
    scene.close()


def test_candidates_keep_their_picture_when_the_next_is_drawn() -> None:
    scene = SoccerScene(size_px=SIZE_PX, rate_hz=25.0, seed=9)
    rng = np.random.default_rng(9)

    first = candidates(scene, 10, rng)
    before = first.picture.copy()
    candidates(scene, 60, rng)

    assert np.array_equal(first.picture, before)
    scene.close()
