"""Windows of the whole pitch: drawn alone they are what the whole picture shows there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.scenes import WholePitchScene
from drivers.source import WindowSource

SMALL = (1280, 720)
LARGE = (5120, 2080)  # its ground is drawn at half the resolution and enlarged
EDGES = 40.0  # grey levels, where several objects and lines meet in one pixel
ROUNDING = 2.0  # grey levels: of the ground's mean, of the noise's, and of laying a patch over it


@pytest.fixture(scope="module")
def scene() -> WholePitchScene:
    return WholePitchScene(size_px=SMALL, seed=3)


@pytest.fixture(scope="module")
def enlarged() -> WholePitchScene:
    return WholePitchScene(size_px=LARGE, seed=3, light="floodlight", weather="rain")


def window(
    scene: WindowSource, index: int, box: tuple[int, int, int, int], reduce: int = 1
) -> NDArray[np.uint8]:
    left, top, right, bottom = box
    out = np.empty(((bottom - top) // reduce, (right - left) // reduce, 3), np.uint8)
    scene.window(index, left, top, right - left, bottom - top, reduce, out)
    return out


def whole(scene: WholePitchScene, index: int, reduce: int) -> NDArray[np.uint8]:
    width, height = (side // reduce * reduce for side in scene.size_px)
    return window(scene, index, (0, 0, width, height), reduce)


def means(picture: NDArray[np.uint8], reduce: int) -> NDArray[np.float64]:
    """Return the exact means over cells of `reduce` x `reduce` pixels."""
    h, w = (side // reduce for side in picture.shape[:2])
    cells = picture[: h * reduce, : w * reduce].reshape(h, reduce, w, reduce, 3)
    return np.asarray(cells.mean((1, 3), dtype=np.float64))


@settings(deadline=None, max_examples=40)
@given(index=st.integers(0, 10_000), data=st.data())
def test_a_window_is_the_crop_of_the_whole_to_the_bit(
    scene: WholePitchScene, index: int, data: st.DataObject
) -> None:
    size = [data.draw(st.integers(1, side)) for side in SMALL]
    left, top = (data.draw(st.integers(0, s - d)) for s, d in zip(SMALL, size, strict=True))
    box = (left, top, left + size[0], top + size[1])

    found = window(scene, index, box)

    np.testing.assert_array_equal(found, scene.picture(index)[top : box[3], left : box[2]])


def test_a_window_of_an_enlarged_ground_in_rain_is_the_crop_of_a_larger_one(
    enlarged: WholePitchScene,
) -> None:
    left, top, right, bottom = 1001, 703, 2900, 1500
    larger = window(enlarged, 77, (left, top, right, bottom))
    rng = np.random.default_rng(1)

    for _ in range(25):
        x, y = rng.integers(0, (right - left - 300, bottom - top - 200)).tolist()
        wide, high = rng.integers(1, (300, 200)).tolist()
        found = window(enlarged, 77, (left + x, top + y, left + x + wide, top + y + high))
        np.testing.assert_array_equal(found, larger[y : y + high, x : x + wide])


@pytest.mark.parametrize("reduce", [2, 3, 4, 5, 8, 10, 16])
def test_the_whole_field_reduced_is_its_mean(scene: WholePitchScene, reduce: int) -> None:
    found = whole(scene, 700, reduce)

    away = found - means(scene.picture(700), reduce)
    assert np.quantile(np.abs(away), 0.99) <= ROUNDING
    assert np.abs(away).max() <= EDGES
    assert abs(away.mean()) < 0.5


def test_a_reduction_without_a_short_way_is_its_mean_too(scene: WholePitchScene) -> None:
    away = whole(scene, 700, 7) - means(scene.picture(700), 7)

    assert np.abs(away).max() <= 0.51


@settings(deadline=None, max_examples=15)
@given(reduce=st.sampled_from([2, 3, 4, 6, 8]), data=st.data())
def test_a_reduced_window_may_begin_anywhere(
    scene: WholePitchScene, reduce: int, data: st.DataObject
) -> None:
    size = [data.draw(st.integers(1, side // reduce)) * reduce for side in SMALL]
    left, top = (data.draw(st.integers(0, s - d)) for s, d in zip(SMALL, size, strict=True))

    found = window(scene, 90, (left, top, left + size[0], top + size[1]), reduce)

    crop = scene.picture(90)[top : top + size[1], left : left + size[0]]
    assert np.abs(found - means(crop, reduce)).max() <= EDGES


def test_an_enlarged_ground_reduced_is_its_mean(enlarged: WholePitchScene) -> None:
    part = (1024, 512, 3072, 1280)

    away = np.abs(window(enlarged, 5, part, 8) - means(window(enlarged, 5, part), 8))

    assert np.quantile(away, 0.99) <= ROUNDING
    assert away.max() <= EDGES


def test_the_same_seed_gives_the_same_bytes_in_any_order(scene: WholePitchScene) -> None:
    other = WholePitchScene(size_px=SMALL, seed=3)

    forward = [whole(scene, index, 4) for index in (10, 4000, 11)]
    backward = [whole(other, index, 4) for index in (11, 4000, 10)]

    for one, two in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_noise_is_new_in_every_frame_and_belongs_to_the_place(scene: WholePitchScene) -> None:
    sky = (0, 0, 300, 40)  # where nothing moves

    first, second = (window(scene, index, sky).astype(float) for index in (20, 21))

    assert np.abs(first - second).mean() > 0.5
    assert abs(first.mean() - second.mean()) < 0.2
