"""Render: footage with truth becomes examples of the context's size."""

from pathlib import Path

import numpy as np
import pytest

from drivers.scenes.soccer import SoccerScene
from operators.saliency.example import CONTEXT_PX, NAMES
from operators.saliency.render import convert, example, made_with, render, shrunk, whole
from pipeline.errors import SettingsError
from tests.drivers.sequences import SIZE_PX, write_sequence

GAME = "[Sequence]\nnum_tracklets=2\ntrackletID_1= player team left;4\ntrackletID_2= ball;1\n"
GT = "1,2,10,20,5,6,1,-1,-1,-1\n2,1,8,12,16,24,1,-1,-1,-1\n2,2,12,20,5,6,1,-1,-1,-1\n"


def test_frames_of_a_sequence_become_examples_with_boxes_at_their_scale(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path / "clip", gt=GT, gameinfo=GAME)

    count = convert(folder, (2, 3), tmp_path / "out")

    truth = np.load(tmp_path / "out" / "2.npz")
    assert count == 2
    assert truth["known"].tolist() == [True, True]
    assert np.load(tmp_path / "out" / "2.npy").shape == (2, CONTEXT_PX[1], CONTEXT_PX[0], 4)
    assert truth["first"].tolist() == [0, 2, 2]
    assert truth["labels"].tolist() == [NAMES.index("player"), NAMES.index("ball")]
    scale = np.array([CONTEXT_PX[i % 2] / SIZE_PX[i % 2] for i in range(4)])
    assert truth["boxes"][0] == pytest.approx(np.array([8, 12, 24, 36]) * scale)


@pytest.mark.parametrize("frames", [(0, 2), (1, 4), (3, 2)])
def test_frames_that_are_not_there_are_refused(tmp_path: Path, frames: tuple[int, int]) -> None:
    folder = write_sequence(tmp_path / "clip", gt=GT, gameinfo=GAME)

    with pytest.raises(SettingsError, match="frames: expected 1 to 3, got"):
        convert(folder, frames, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_moment_of_a_drawn_scene_is_a_context_and_parts_as_a_roi_shows_them(
    tmp_path: Path,
) -> None:
    render([10_000], 2, 40, tmp_path, workers=1, rois=3)

    pictures, truth = np.load(tmp_path / "10000.npy"), np.load(tmp_path / "10000.npz")
    people = truth["labels"] == NAMES.index("player")
    heights = (truth["boxes"][:, 3] - truth["boxes"][:, 1])[people]
    of_context = np.repeat(truth["known"], np.diff(truth["first"]))[people]
    assert pictures.shape == (2 * (1 + 3), CONTEXT_PX[1], CONTEXT_PX[0], 4)
    assert truth["known"].tolist() == [True, False, False, False] * 2
    # a quarter of full resolution there, .6 to 2 of it here
    assert np.median(heights[~of_context]) > 2 * np.median(heights[of_context])
    assert (truth["boxes"] >= 0).all()
    assert (truth["boxes"] <= np.tile(CONTEXT_PX, 2)).all()


@pytest.mark.parametrize("size_px", [CONTEXT_PX, (1920, 1080)])
def test_a_picture_stays_what_it_was_when_its_source_draws_the_next(
    size_px: tuple[int, int],
) -> None:
    scene = SoccerScene(size_px=size_px, rate_hz=25.0, seed=3)
    alone = whole(scene, 30).picture.copy()

    picture, shown = whole(scene, 30), example(scene, 30)
    scene.picture(200)

    assert (picture.picture == alone).all()
    assert (shown.picture == shrunk(alone)).all()
    assert shown.difference is not None
    assert shown.difference.any()
    scene.close()


def test_pictures_of_rois_make_another_set() -> None:
    assert "rois" not in made_with(2, 40)
    assert len({str(made_with(2, 40, rois)) for rois in (0, 1, 2)}) == 3
