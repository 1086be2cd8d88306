"""The procedural match as a source of pictures with truth."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.scenes.soccer import SoccerScene
from drivers.source import FrameSource
from pipeline.errors import SettingsError

SMALL = (480, 270)
LABELS = {"ball", "player", "goalkeeper", "main referee", "assistant referee"}


@pytest.fixture(scope="module")
def scene() -> Iterator[SoccerScene]:
    made = SoccerScene(size_px=SMALL, seed=3)
    yield made
    made.close()


def test_it_is_a_frame_source(scene: SoccerScene) -> None:
    source: FrameSource = scene

    picture = source.picture(0)

    assert picture.shape == (270, 480, 3)
    assert picture.dtype == np.uint8
    assert source.length is None


def test_the_same_seed_gives_the_same_bytes_in_any_order(scene: SoccerScene) -> None:
    other = SoccerScene(size_px=SMALL, seed=3)

    forward = [scene.picture(index).copy() for index in (10, 400, 11)]
    backward = [other.picture(index).copy() for index in (11, 400, 10)]

    for one, two in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(one, two)


def test_another_seed_is_another_match(scene: SoccerScene) -> None:
    other = SoccerScene(size_px=SMALL, seed=4)

    difference = np.abs(scene.picture(5).astype(int) - other.picture(5))

    assert difference.mean() > 5


def test_truth_does_not_depend_on_whether_the_picture_was_drawn(scene: SoccerScene) -> None:
    fresh = SoccerScene(size_px=SMALL, seed=3)

    scene.picture(77)
    seen, unseen = scene.truth(77), fresh.truth(77)

    np.testing.assert_array_equal(seen.boxes, unseen.boxes)
    np.testing.assert_array_equal(seen.visibility, unseen.visibility)


@settings(max_examples=12, deadline=None)
@given(index=st.integers(0, 10**7))
def test_boxes_lie_in_the_picture_and_are_not_empty(scene: SoccerScene, index: int) -> None:
    truth = scene.truth(index)

    assert len(truth.boxes) == len(truth.ids) == len(truth.labels) == len(truth.visibility)
    assert (truth.boxes[:, :2] >= 0).all()
    assert (truth.boxes[:, 2:] <= np.array(SMALL)).all()
    assert (truth.boxes[:, 2:] > truth.boxes[:, :2]).all()
    assert ((truth.visibility >= 0) & (truth.visibility <= 1)).all()
    assert set(truth.labels) <= LABELS
    assert len(set(truth.ids.tolist())) == len(truth.ids)


def test_an_id_stands_for_the_same_person_throughout(scene: SoccerScene) -> None:
    named: dict[int, set[str]] = {}
    for index in range(0, 3000, 250):
        truth = scene.truth(index)
        for number, label in zip(truth.ids.tolist(), truth.labels, strict=True):
            named.setdefault(number, set()).add(label)

    assert all(len(labels) == 1 for labels in named.values())
    assert set.union(*named.values()) >= {"ball", "player", "main referee"}


def test_nobody_jumps_from_one_frame_to_the_next(scene: SoccerScene) -> None:
    for index in (298, 299, 300, 301, 599, 600):  # chunks of play meet at 300 and 600
        before, after = scene.truth(index), scene.truth(index + 1)
        places = dict(zip(before.ids.tolist(), before.boxes, strict=True))
        for number, box in zip(after.ids.tolist(), after.boxes, strict=True):
            if number in places and box[0] > 0 and box[2] < SMALL[0]:
                assert abs(box[3] - places[number][3]) < 12


def test_the_ball_is_drawn_inside_its_box() -> None:
    found = 0
    with_ball = SoccerScene(size_px=(960, 540), seed=1)
    without = SoccerScene(size_px=(960, 540), seed=1, ball=False)
    for index in range(0, 600, 60):
        truth = with_ball.truth(index)
        if "ball" not in truth.labels:
            continue
        which = truth.labels.index("ball")
        if truth.visibility[which] < 0.9:
            continue
        x0, y0, x1, y1 = truth.boxes[which].astype(int)

        changed = np.abs(with_ball.picture(index).astype(int) - without.picture(index)).sum(2) > 90

        inside = changed[y0:y1, x0:x1]
        assert inside.mean() > 0.4
        changed[y0 - 2 : y1 + 2, x0 - 2 : x1 + 2] = False
        assert changed.sum() <= inside.sum()  # only its shadow is outside
        assert "ball" not in without.truth(index).labels
        found += 1
    assert found >= 4


def test_any_frame_of_an_endless_match_is_drawn_without_those_before_it(scene: SoccerScene) -> None:
    begun_s = time.thread_time()

    scene.picture(100_000)

    assert time.thread_time() - begun_s < 20  # drawing all frames before it takes an hour


def test_a_match_of_given_length_ends(scene: SoccerScene) -> None:
    short = SoccerScene(size_px=SMALL, length=3)

    short.picture(2)

    with pytest.raises(IndexError, match="frame 3: the scene is 3 frames long"):
        short.picture(3)
    with pytest.raises(IndexError, match="frame -1: the scene is endless"):
        scene.truth(-1)


@pytest.mark.parametrize("size_px", [(320, 180), (641, 363), (500, 500), (2560, 1440)])
def test_pictures_of_any_size_are_drawn(size_px: tuple[int, int]) -> None:
    scene = SoccerScene(size_px=size_px, seed=2)

    assert scene.picture(30).shape == (size_px[1], size_px[0], 3)
    assert (scene.truth(30).boxes[:, 2:] <= np.array(size_px)).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"size_px": (10, 10)}, "size_px: expected"),
        ({"rate_hz": 0.0}, "rate_hz: expected"),
        ({"seed": -1}, "seed: must be at least 0, got -1"),
        ({"length": -1}, "length: must be at least 0, got -1"),
        ({"difficulty": 2.0}, "difficulty: expected 0 to 1, got 2.0"),
    ],
)
def test_impossible_settings_are_refused_by_name(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        SoccerScene(**wrong)  # type: ignore[arg-type]


def test_a_picture_is_drawn_fast() -> None:
    scene = SoccerScene(seed=1)
    for index in range(5):
        scene.picture(index)

    times = []
    for index in range(5, 15):
        begun = time.process_time()  # does not count other work on the machine
        scene.picture(index)
        times.append(time.process_time() - begun)

    assert min(times) < 0.3  # an ordinary core takes a tenth of that
