"""Photographs behind drawn boards: which ones, which part, and the texts that they have already."""

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the text extra")

from operators.saliency.text.examples import made_of_streets
from operators.saliency.text.photographs import labelled_in, part_of, photographs_in
from operators.saliency.text.quads import upright
from operators.saliency.text.streets import FULL_PX
from operators.training.splits import DEVELOPMENT, TEST
from pipeline.errors import DriverError


def wall(path: Path, text: str = "") -> Path:
    pixels = np.full((1080, 1920, 3), (90, 110, 100), np.uint8)
    cv2.putText(pixels, text, (700, 560), cv2.FONT_HERSHEY_SIMPLEX, 3, (250, 250, 250), 8)
    cv2.imwrite(str(path), pixels)
    return path


def test_the_texts_of_a_photograph_may_be_found_or_not(tmp_path: Path) -> None:
    pytest.importorskip("rapidocr", reason="needs the reader extra")
    path, found = wall(tmp_path / "wall.jpg", "BAKERY"), []

    for seed in range(4):
        part = part_of(path, np.random.default_rng(seed))
        found.extend(upright(part.quads[part.ignored]))
        assert part.pixels.shape == (*FULL_PX[::-1], 3)
        assert part.ignored.all()
        for box in upright(part.quads).astype(int):
            x0, y0, x1, y1 = box.clip(0)
            assert part.pixels[y0:y1, x0:x1].max() > 200  # ink, not wall

    assert found
    assert not len(part_of(wall(tmp_path / "bare.jpg"), np.random.default_rng(1)).quads)


def test_photographs_for_development_and_test_are_not_for_training(tmp_path: Path) -> None:
    for name in ("mine_1", f"{DEVELOPMENT[0]}_3_1", f"{TEST[0]}_0_2", f"{TEST[1]}_0_5"):
        wall(tmp_path / f"{name}.jpg")

    found = {s: len(photographs_in(tmp_path, s)) for s in ("training", "development", "held-out")}

    assert found == {"training": 1, "development": 1, "held-out": 2}
    with pytest.raises(DriverError, match=r"expected photographs \(\.jpg\) for training, got none"):
        photographs_in(tmp_path / "elsewhere")


def test_other_photographs_make_other_streets(tmp_path: Path) -> None:
    (tmp_path / "moved").mkdir()
    first = wall(tmp_path / "wall.jpg", "ONE")
    same, other = wall(tmp_path / "moved" / "wall.jpg", "ONE"), wall(tmp_path / "b.jpg", "TWO")

    assert made_of_streets([first]) == made_of_streets([same])
    assert made_of_streets([first]) != made_of_streets([other])
    assert made_of_streets([first]) != made_of_streets()


def test_a_photograph_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no picture")

    with pytest.raises(DriverError, match=r"broken\.jpg: expected a whole picture"):
        part_of(broken, np.random.default_rng(1))


def test_words_of_a_labelled_photograph_are_scaled_with_it(tmp_path: Path) -> None:
    wall(tmp_path / "img_1.jpg")
    wall(tmp_path / "img_2.jpg")  # without labels
    (tmp_path / "gt_img_1.txt").write_text(
        "300,150,600,150,600,300,300,300,OPEN\n0,0,90,0,90,30,0,30,###\n"
    )

    (picture,) = labelled_in(tmp_path)

    assert picture.pixels.shape == (*FULL_PX[::-1], 3)
    assert upright(picture.quads).tolist() == [[200, 100, 400, 200], [0, 0, 60, 20]]
    assert picture.ignored.tolist() == [False, True]
    with pytest.raises(DriverError, match=r"expected photographs \(\.jpg\) with labels"):
        list(labelled_in(tmp_path / "elsewhere"))
