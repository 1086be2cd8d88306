"""Drawn streets: words whose corners are known."""

from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the text extra")

from operators.saliency.text.examples import KEPT_PX, PICTURES, draw
from operators.saliency.text.examples import drawn as drawn_parts
from operators.saliency.text.quads import areas, upright
from operators.saliency.text.streets import FULL_PX, Picture, _share, _stick, backdrop, street
from operators.saliency.text.words import Board, board


def drawn(seed: int) -> Picture:
    return street(np.random.default_rng(seed))


def test_a_seed_draws_the_same_street_each_time() -> None:
    first, again = drawn(3), drawn(3)

    np.testing.assert_array_equal(first.pixels, again.pixels)
    np.testing.assert_array_equal(first.quads, again.quads)


def test_the_ink_of_a_board_is_inside_its_words() -> None:
    found = 0
    for seed in range(30):
        made = board(np.random.default_rng(seed), 30.0)
        if made.alpha.min() == 0:  # letters alone: what is opaque is ink
            outside = made.alpha.copy()
            for x0, y0, x1, y1 in upright(made.quads).astype(int):
                outside[max(y0, 0) : y1 + 1, max(x0, 0) : x1 + 1] = 0
            assert made.alpha.max() > 0
            assert outside.max() == 0
            found += 1

    assert found > 3


@pytest.mark.parametrize("opaque", [True, False])
def test_words_of_an_enlarged_board_lie_where_their_corners_are(opaque: bool) -> None:
    pixels, street = np.zeros((60, 80, 3), np.uint8), np.zeros((*FULL_PX[::-1], 3), np.uint8)
    pixels[20:40, 30:50] = 255
    alpha = np.full((60, 80), 255, np.uint8)
    alpha[0, 0] = 255 if opaque else 0
    words = np.array([[[30, 20], [50, 20], [50, 40], [30, 40]]], np.float32)
    target = np.array([[100, 100], [420, 100], [420, 340], [100, 340]], np.float32)

    (quad,) = _stick(street, Board(pixels=pixels, alpha=alpha, quads=words), target)

    light = street[..., 0] / street[..., 0].sum()
    rows, columns = np.indices(light.shape) + 0.5
    middle = [(light * columns).sum(), (light * rows).sum()]
    np.testing.assert_allclose(middle, quad.mean(0), atol=0.1)


def test_words_that_are_wanted_are_in_the_picture() -> None:
    for seed in range(6):
        picture = drawn(seed)
        seen = picture.quads[~picture.ignored]

        inner = np.clip(seen, 0, np.array(FULL_PX, np.float32))
        assert (areas(inner) >= 0.3 * areas(seen)).all()


def test_a_word_behind_a_pole_is_not_wanted() -> None:
    quad = np.array([[100, 100], [180, 100], [180, 120], [100, 120]], np.float32)
    hidden = np.zeros(FULL_PX[::-1], np.bool_)

    assert _share(quad, hidden) == 1
    hidden[:, 90:200] = True
    assert _share(quad, hidden) == 0


def test_a_photograph_may_lie_behind_the_words_and_its_own_texts_may_be_found_or_not() -> None:
    pixels = np.full((*FULL_PX[::-1], 3), 7, np.uint8)
    own = np.array([[[10, 10], [90, 10], [90, 40], [10, 40]]], np.float32)
    photograph = Picture(pixels=pixels, quads=own, ignored=np.array([True]))

    picture = street(np.random.default_rng(2), photograph)

    assert (picture.pixels == 7).all(2).mean() > 0.3
    assert (pixels == 7).all()
    assert (picture.quads[-1:] == own).all()
    assert picture.ignored[-1]
    assert (~picture.ignored[:-1]).any()
    assert backdrop(np.random.default_rng(2)).std() > 5


@pytest.mark.lengthy
def test_kept_pictures_are_drawn_once_and_every_other_one_lies_on_a_photograph(
    tmp_path: Path,
) -> None:
    pytest.importorskip("rapidocr", reason="needs the reader extra")
    photograph = tmp_path / "wall.jpg"
    cv2.imwrite(str(photograph), np.full((900, 1600, 3), (10, 200, 30), np.uint8))
    made = {"code": "1"}

    def parts() -> None:
        draw([4], tmp_path / "kept", made, partial(drawn_parts, stills=[photograph]), 1, "draw")

    parts()
    pictures = np.load(tmp_path / "kept" / "4.npy")
    before = (tmp_path / "kept" / "4.npz").stat().st_mtime_ns
    parts()

    green = (np.abs(pictures.astype(int) - [30, 200, 10]).max(3) < 12).mean((1, 2))
    assert pictures.shape == (PICTURES, KEPT_PX[1], KEPT_PX[0], 3)
    assert green[1::2].min() > 0.1
    assert np.median(green[::2]) < 0.02
    assert (tmp_path / "kept" / "4.npz").stat().st_mtime_ns == before
