"""What is written on shirts in the whole-pitch scene."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scenes import WholePitchScene
from drivers.scenes.soccer import figures
from drivers.scenes.soccer.looks import everybody, named
from drivers.scenes.soccer.shirts import (
    ILLEGIBLE,
    LEAST_CLEAR,
    LEAST_LEGIBLE_PX,
    NAME_IDS,
    shirts_of,
)
from drivers.scenes.soccer.skeleton import DIRECTIONS, Pose
from drivers.scenes.soccer.stage import Actor
from pipeline.errors import SettingsError

SIZE = (1600, 900)
BACK, CHEST = 3 * DIRECTIONS // 4, DIRECTIONS // 4


def sprite(direction: int, who: int = 0) -> figures.Sprite:
    look = named(everybody(1), 1)[who]
    pose = Pose(gait="stand", phase=0, direction=direction)
    return figures.draw(look, pose, 400, np.ones(3), 0.0)


def actor(left: int = 100, top: int = 100, box: tuple[float, ...] = (10, 20, 40, 40)) -> Actor:
    x0, y0, x1, y1 = (v + o for v, o in zip(box, (left, top, left, top), strict=True))
    return Actor(
        id=7,
        label="player",
        patch=np.full((100, 60, 4), 255, np.uint8),
        left=left,
        top=top,
        box=(left, top, left + 60, top + 100),
        nearer=0.0,
        ground=(0.0, 0.0),
        scale=50.0,
        prints=(figures.Print(text="21", box=(x0, y0, x1, y1)),),
    )


def test_a_back_shows_number_and_name_and_a_chest_neither_as_truth() -> None:
    look = named(everybody(1), 1)[0]

    back, chest = sprite(BACK), sprite(CHEST)

    assert [p.text for p in back.prints] == [look.number, look.name]
    assert not chest.prints


def test_a_print_is_where_the_ink_is() -> None:
    number = sprite(BACK).prints[0]
    plain = everybody(1)[0]
    without = figures.draw(
        plain.__class__(**{**plain.__dict__, "number": "", "name": ""}),
        Pose(gait="stand", phase=0, direction=BACK), 400, np.ones(3), 0.0,
    )  # fmt: skip
    x0, y0, x1, y1 = (round(v) for v in number.box)

    changed = (sprite(BACK).image != without.image).any(-1)

    inside = changed[y0:y1, x0:x1]
    assert inside.mean() > 0.2
    assert inside.any(0).mean() > 0.85  # from its left to its right
    assert inside.any(1).mean() > 0.95


def test_an_arm_before_the_number_counts_as_hiding_it() -> None:
    seen = [
        print_.seen
        for direction in (BACK - 1, BACK + 1)
        for phase in range(8)
        for print_ in figures.draw(
            everybody(1)[0], Pose(gait="run", phase=phase, direction=direction), 400, np.ones(3), 0
        ).prints
    ]

    assert min(seen) < 0.9
    assert sprite(BACK).prints[0].seen > 0.95


def test_officials_bear_neither() -> None:
    assert not sprite(BACK, who=24).prints


def test_the_id_of_a_number_is_that_of_its_person() -> None:
    truth = shirts_of([actor()], SIZE)

    assert truth.ids.tolist() == [7]
    assert truth.labels == ("21",)
    assert truth.boxes.tolist() == [[110, 120, 140, 140]]


def test_a_number_behind_another_person_is_not_to_be_scored() -> None:
    near = actor(left=118, top=90)

    truth = shirts_of([actor(), near], SIZE)

    assert truth.labels == (ILLEGIBLE, "21")
    assert truth.visibility[0] == pytest.approx(8 / 30)


def test_a_number_of_few_pixels_is_not_to_be_scored() -> None:
    truth = shirts_of([actor(box=(10, 20, 40, 20 + LEAST_LEGIBLE_PX - 1))], SIZE)

    assert truth.labels == (ILLEGIBLE,)


def test_a_number_outside_the_picture_is_left_out() -> None:
    assert not len(shirts_of([actor(left=-50)], SIZE).ids)


@pytest.mark.parametrize("names", [False, True])
def test_the_scene_tells_what_backs_show_and_nothing_else(names: bool) -> None:
    scene = WholePitchScene(size_px=(3840, 2160), seed=3, names=names, truth_of="shirts")
    looks = named(everybody(3), 3)

    truths = [scene.truth(index) for index in range(0, 200, 20)]

    ids = {int(i) for truth in truths for i in truth.ids}
    assert ids
    assert any(i > NAME_IDS for i in ids) == names
    for truth in truths:
        for id_, label in zip(truth.ids.tolist(), truth.labels, strict=True):
            look = looks[(id_ - 1) % NAME_IDS]
            assert label in (ILLEGIBLE, look.name if id_ > NAME_IDS else look.number)


def test_without_names_the_picture_is_as_before() -> None:
    usual = WholePitchScene(size_px=(1280, 720), seed=3)
    told = WholePitchScene(size_px=(1280, 720), seed=3, truth_of="shirts")

    assert np.array_equal(usual.picture(4), told.picture(4))


def test_another_truth_is_refused() -> None:
    with pytest.raises(SettingsError, match="truth_of: expected objects or shirts, got 'names'"):
        WholePitchScene(truth_of="names")


def test_white_on_white_stripes_is_not_to_be_scored() -> None:
    look = everybody(1)[0]
    white, blue = (245, 245, 245), (20, 30, 70)

    def clear(pattern: str, trim: tuple[int, int, int]) -> float:
        worn = replace(look, shirt=blue, trim=trim, ink=white, pattern=pattern)
        pose = Pose(gait="stand", phase=0, direction=BACK)
        return figures.draw(worn, pose, 400, np.ones(3), 0.0).prints[0].clear

    assert clear("plain", white) > 0.95
    assert clear("stripes", (200, 30, 40)) > 0.95
    assert clear("stripes", white) < LEAST_CLEAR


def test_a_number_that_does_not_stand_out_is_illegible() -> None:
    faint = replace(actor().prints[0], clear=LEAST_CLEAR - 0.01)

    assert shirts_of([replace(actor(), prints=(faint,))], SIZE).labels == (ILLEGIBLE,)
