"""The panorama: a field of any size that is read by windows, with exact truth."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.scenes import PanoramaScene
from drivers.source import WindowSource
from pipeline.errors import DriverError, SettingsError
from tests.shared_data import Footage

SMALL = (1088, 624)
EDGES = 48.0  # grey levels at the edges of objects, whose mean opacity covers the mean ground
ROUNDING = 3.0  # grey levels: of the ground's mean, of the patch's, and of laying it over


@pytest.fixture(scope="module")
def scene() -> PanoramaScene:
    return PanoramaScene(size_px=SMALL, seed=3)


def window(
    scene: WindowSource, index: int, box: tuple[int, int, int, int], reduce: int = 1
) -> NDArray[np.uint8]:
    left, top, right, bottom = box
    out = np.empty(((bottom - top) // reduce, (right - left) // reduce, 3), np.uint8)
    scene.window(index, left, top, right - left, bottom - top, reduce, out)
    return out


def means(picture: NDArray[np.uint8], reduce: int) -> NDArray[np.float64]:
    """Return the exact means over cells of `reduce` x `reduce` pixels."""
    h, w = (side // reduce for side in picture.shape[:2])
    cells = picture[: h * reduce, : w * reduce].reshape(h, reduce, w, reduce, 3)
    return np.asarray(cells.mean((1, 3), dtype=np.float64))


def test_the_same_seed_gives_the_same_bytes_in_any_order(scene: PanoramaScene) -> None:
    other, whole = PanoramaScene(size_px=SMALL, seed=3), (0, 0, *SMALL)

    forward = [window(scene, index, whole) for index in (10, 4000, 11)]
    backward = [window(other, index, whole) for index in (11, 4000, 10)]

    for one, two in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(one, two)


def test_another_seed_is_another_field(scene: PanoramaScene) -> None:
    other = PanoramaScene(size_px=SMALL, seed=4)

    assert scene.truth(5).boxes.tolist() != other.truth(5).boxes.tolist()
    assert np.abs(scene.picture(5).astype(int) - other.picture(5)).mean() > 2


@settings(deadline=None, max_examples=60)
@given(index=st.integers(0, 10_000), reduce=st.sampled_from([1, 1, 2, 3, 4, 8, 16]), data=st.data())
def test_a_window_is_the_crop_of_the_whole_and_its_mean(
    scene: PanoramaScene, index: int, reduce: int, data: st.DataObject
) -> None:
    size = [data.draw(st.integers(1, side // reduce)) * reduce for side in SMALL]
    left, top = (data.draw(st.integers(0, s - d)) for s, d in zip(SMALL, size, strict=True))
    box = (left, top, left + size[0], top + size[1])

    found = window(scene, index, box, reduce)

    crop = scene.picture(index)[box[1] : box[3], box[0] : box[2]]
    if reduce == 1:
        np.testing.assert_array_equal(found, crop)
    else:
        away = np.abs(found - means(crop, reduce))
        assert away.max() <= EDGES


@pytest.mark.parametrize("reduce", [2, 3, 4, 8, 16])
def test_the_whole_field_reduced_is_its_mean(scene: PanoramaScene, reduce: int) -> None:
    width, height = (side - side % reduce for side in SMALL)

    found = window(scene, 700, (0, 0, width, height), reduce)

    away = np.abs(found - means(scene.picture(700), reduce))
    assert np.quantile(away, 0.99) <= ROUNDING
    assert away.max() <= EDGES


def test_truth_is_where_the_pixels_change(scene: PanoramaScene) -> None:
    with_ball = PanoramaScene(size_px=SMALL, seed=3, objects=0)
    for index in (0, 333, 5000):
        truth = scene.truth(index)
        changed = np.abs(scene.picture(index).astype(int) - with_ball.picture(index)).max(-1)
        inside = np.zeros(changed.shape, bool)
        for box, label, share in zip(truth.boxes, truth.labels, truth.visibility, strict=True):
            left, top, right, bottom = box.astype(int)
            inside[max(0, top - 3) : bottom + 3, max(0, left - 3) : right + 3] = True
            if label != "ball" and share == 1:
                tall = np.flatnonzero((changed > 40)[top:bottom, left:right].any(1))
                assert tall[0] <= 3
                assert tall[-1] >= bottom - top - 4

        assert not ((changed > 90) & ~inside).any()  # no shadow changes as much


def test_the_balls_truth_is_its_box() -> None:
    alone = PanoramaScene(size_px=SMALL, seed=3, objects=0)
    (left, top, right, bottom) = alone.truth(50).boxes[0].astype(int)

    changed = np.abs(alone.picture(50).astype(int) - alone.picture(900)).max(-1) > 40

    rows, columns = (
        np.flatnonzero(changed[top - 6 : bottom + 6, left - 6 : right + 6].any(k)) for k in (1, 0)
    )
    assert abs(rows[0] - 6) <= 1
    assert abs(rows[-1] + 1 - 6 - (bottom - top)) <= 2
    assert abs(columns[0] - 6) <= 1
    assert abs(columns[-1] + 1 - 6 - (right - left)) <= 1


def test_an_object_moves_the_same_however_many_others_there_are(scene: PanoramaScene) -> None:
    fewer = PanoramaScene(size_px=SMALL, seed=3, objects=4)

    assert fewer.truth(99).boxes.tolist() == scene.truth(99).boxes[:5].tolist()


def test_every_object_stays_inside_and_keeps_its_id(scene: PanoramaScene) -> None:
    first = scene.truth(0)
    for index in range(0, 20_000, 997):
        truth = scene.truth(index)

        assert truth.ids.tolist() == list(range(1, 12))
        assert truth.labels == first.labels
        assert (truth.boxes[:, :2] > 0).all()
        assert (truth.boxes[:, 2:] < SMALL).all()
        assert (truth.visibility >= 0).all()


@pytest.mark.parametrize(
    "options", [{"size_px": (160, 90), "objects": 25}, {"ball_share": 0.3}, {"person_share": 0.3}]
)
def test_objects_of_any_size_are_inside_and_what_hides_them_counts(
    options: dict[str, Any],
) -> None:
    made = PanoramaScene(**{"size_px": (640, 360), "seed": 1, **options})
    shares = []
    for index in range(0, 6000, 150):
        truth = made.truth(index)
        shares += truth.visibility.tolist()

        assert (truth.boxes[:, :2] >= 0).all()
        assert (truth.boxes[:, 2:] <= made.size_px).all()
        assert window(made, index, (0, 0, *made.size_px)).any()

    assert 0 <= min(shares) < 1
    assert max(shares) == 1


def test_there_are_a_ball_a_referee_and_players_of_two_teams(scene: PanoramaScene) -> None:
    labels = scene.truth(0).labels

    assert labels.count("ball") == 1
    assert labels.count("main referee") == 1
    assert labels.count("player") == 9


def test_objects_move_smoothly(scene: PanoramaScene) -> None:
    boxes = np.array([scene.truth(index).boxes for index in range(60)])
    feet = np.stack([boxes[..., [0, 2]].mean(-1), boxes[..., 3]], -1)  # (60, n, 2)

    step = np.linalg.norm(np.diff(feet[:, :1], axis=0), axis=-1)  # the ball has one shape

    assert step.max() < 0.01 * SMALL[0]
    assert step.mean() > 0.3


def test_photographs_are_laid_like_tiles(tmp_path: Path) -> None:
    colours = ((200, 30, 30), (30, 30, 200))
    for number, colour in enumerate(colours):
        tile = np.full((200, 300, 3), colour[::-1], np.uint8)
        cv2.imwrite(str(tmp_path / f"{number}.png"), tile)
    laid = PanoramaScene(size_px=SMALL, path=str(tmp_path), objects=0)

    # tiles are cut to 288 x 192; each row of them begins with another
    for left, top, which in ((0, 0, 0), (288, 0, 1), (0, 192, 1), (288, 192, 0)):
        ball = laid.truth(0).boxes[0]
        spot = (left + 20, top + 20, left + 30, top + 30)
        if not (ball[0] - 9 < spot[2] and spot[0] < ball[2] + 9):
            assert (window(laid, 0, spot) == colours[which]).all()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"size_px": (40_000, 100)}, "size_px: expected"),
        ({"objects": 26}, "objects: expected 0 to 25, got 26"),
        ({"person_share": 2.0}, "person_share: expected 0.001 to 0.3 of the height, got 2.0"),
        ({"size_px": (160, 9000)}, "person_share: expected people that fit into 160x9000, got 0.1"),
        ({"ball_share": 0.0}, "ball_share: expected 0.001 to 0.3 of the height, got 0.0"),
        ({"seed": -1}, "seed: must be at least 0, got -1"),
        ({"rate_hz": 0.0}, "rate_hz: expected 1 to 1000, got 0.0"),
        ({"length": -1}, "length: must be at least 0, got -1"),
    ],
)
def test_settings_out_of_range_are_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        PanoramaScene(**options)


def test_a_folder_without_pictures_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="expected a picture or a folder of pictures, got none"):
        PanoramaScene(size_px=SMALL, path=str(tmp_path))


def test_a_picture_that_is_too_small_is_refused_by_name(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "stamp.png"), np.zeros((20, 30, 3), np.uint8))

    with pytest.raises(DriverError, match=r"stamp\.png: expected sides of at least 48 pixels"):
        PanoramaScene(size_px=SMALL, path=str(tmp_path))


@pytest.mark.parametrize(
    ("box", "reduce"), [((-1, 0, 9, 10), 1), ((0, 0, *SMALL[:1], 640), 1), ((0, 0, 9, 9), 2)]
)
def test_a_window_outside_the_field_is_refused(
    scene: PanoramaScene, box: tuple[int, int, int, int], reduce: int
) -> None:
    with pytest.raises(DriverError, match="panorama: expected a window inside 1088x624"):
        window(scene, 0, box, reduce)


def test_a_frame_past_the_end_is_an_index_error() -> None:
    short = PanoramaScene(size_px=SMALL, length=3)

    with pytest.raises(IndexError, match="3 frames long"):
        short.truth(3)


def test_the_whole_field_of_200_megapixels_takes_little_memory() -> None:
    large = PanoramaScene(seed=1)

    context = window(large, 0, (0, 0, 16_320, 9_184), 8)
    roi = window(large, 0, (6000, 3000, 10_080, 5296))

    assert context.shape == (1148, 2040, 3)
    assert roi.shape == (2296, 4080, 3)
    assert large.kept_bytes < 200 << 20
    away = np.abs(means(roi, 8) - context[375 : 375 + 287, 750 : 750 + 510])
    assert np.quantile(away, 0.999) <= ROUNDING


def test_reduced_copies_of_what_is_pasted_count_as_kept() -> None:
    large = PanoramaScene(size_px=(4352, 2496), seed=3)
    window(large, 0, (0, 0, 4352, 2496))
    before = large.kept_bytes

    window(large, 0, (0, 0, 4352, 2496), 2)

    assert large.kept_bytes > before


@pytest.mark.footage
def test_photographs_of_a_real_panorama_are_the_ground(footage: Footage) -> None:
    large = PanoramaScene(path=str(footage.data("panorama")), objects=1)

    roi = window(large, 100, (7000, 3400, 11_080, 5696))

    assert roi.std() > 10
    assert large.kept_bytes < 400 << 20
