"""The ball among what a ROI shows, over a network whose answers are known."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.detector_scoring import Found
from bench.roi_balls import NEAR_PX, best_scores, main, mirrored, row_of, window
from bench.second_look import WINDOW_PX
from operators.training.stills import Labelled
from tests.bench.test_ball_candidates import FRAMES, GT, ROLES, weights
from tests.drivers.sequences import write_sequence


@pytest.mark.parametrize("corner", [(5, 5), (900, 500), (1900, 1060)])
def test_a_window_shows_the_ball_where_it_is(corner: tuple[int, int]) -> None:
    picture = np.zeros((1080, 1920, 3), np.uint8)
    left, top = corner
    picture[top : top + 10, left : left + 10] = 255
    ball = np.array([left, top, left + 10, top + 10], np.float32)

    for seed in range(20):
        part = window(picture, ball, np.random.default_rng(seed))

        assert part.picture.shape == (WINDOW_PX[1], WINDOW_PX[0], 3)
        x0, y0, x1, y1 = part.boxes[0].astype(int)
        assert part.picture[y0:y1, x0:x1].min() == 255
        assert part.picture.sum() == 255 * 3 * 100


def test_a_mirrored_window_shows_the_ball_on_the_other_side() -> None:
    picture = np.zeros((30, 100, 3), np.uint8)
    picture[5:9, 10:16] = 255
    part = Labelled(
        picture=picture, boxes=np.array([[10, 5, 16, 9]], np.float32), numbers=np.array([0])
    )

    other = mirrored(part)

    assert other.boxes.tolist() == [[84, 5, 90, 9]]
    assert other.picture[5:9, 84:90].min() == 255
    assert mirrored(other).boxes.tolist() == part.boxes.tolist()
    assert (mirrored(other).picture == picture).all()


def test_what_is_found_beside_the_ball_is_another_thing() -> None:
    ball = np.array([100, 100, 112, 112], np.float32)
    reach = 6 + NEAR_PX
    boxes = np.array([[x, 106, x, 106] for x in (106 + reach - 1, 106 + reach + 1)], np.float32)
    found: Found = {"ball": (boxes, np.array([0.4, 0.7], np.float32))}

    assert best_scores(found, ball) == pytest.approx((0.4, 0.7))
    assert best_scores({"ball": (boxes[:0], boxes[:0, 0])}, ball) == (0, 0)


def test_ties_are_not_rated_best_and_count_half_of_a_pair() -> None:
    row = row_of("a", "still", [(0.5, 0.5), (0.9, 0.1)], [(0.2, 0.5), (0.4, 0.4)])

    assert (row["windows"], row["rated best"], row["mirrored"]) == (2, 0.5, 0.0)
    assert row["pairs"] == (0.5 + 1 + 1 + 1) / 4


def test_a_report_has_a_row_for_each_detector_and_state_of_the_ball(tmp_path: Path) -> None:
    sequence = write_sequence(tmp_path / "s", gt=GT, gameinfo=ROLES, frames=FRAMES)
    path = tmp_path / "figures.json"
    line = [f"a={weights(tmp_path, 5.0)}", "--sequence", str(sequence), "--json", str(path)]

    done = CliRunner().invoke(main, line)

    assert done.exit_code == 0, done.output
    (row,) = json.loads(path.read_text())["rows"]
    assert (row["detector"], row["ball"], row["windows"]) == ("a", "still", FRAMES // 2)
    assert row["rated best"] == 0.0  # it rates two others higher, wherever it looks


def test_without_pictures_it_says_what_it_expects() -> None:
    done = CliRunner().invoke(main, ["a=roi"])

    assert done.exit_code == 1
    assert "expected --sequence or --football, got neither" in done.output
