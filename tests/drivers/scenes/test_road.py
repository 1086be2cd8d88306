"""The road scene: texts along a street, with exact truth."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("PIL")
pytest.importorskip("fontTools")

from drivers.scenes import RoadScene
from drivers.scenes.road import lettering
from drivers.scenes.road.panels import Panel, board
from drivers.scenes.road.scene import ILLEGIBLE, LEAST_LEGIBLE_PX
from drivers.scenes.road.street import SEGMENT_M
from drivers.simulated.sources import open_scene
from pipeline.errors import DriverError, SettingsError

SMALL = (640, 360)


def window(
    scene: RoadScene, index: int, box: tuple[int, int, int, int], reduce: int = 1
) -> NDArray[np.uint8]:
    left, top, right, low = box
    out = np.empty(((low - top) // reduce, (right - left) // reduce, 3), np.uint8)
    scene.window(index, left, top, right - left, low - top, reduce, out)
    return out


def test_the_same_seed_gives_the_same_pictures_in_any_order() -> None:
    one, other = (RoadScene(size_px=SMALL, seed=5, weather="rain") for _ in range(2))

    forward = [one.picture(index) for index in (0, 7)]
    backward = [other.picture(index) for index in (7, 0)]

    assert np.array_equal(forward[0], backward[1])
    assert np.array_equal(forward[1], backward[0])


def test_another_seed_is_another_street() -> None:
    texts = [set(RoadScene(seed=seed).truth(0).labels) for seed in (1, 2)]

    assert texts[0] - {ILLEGIBLE} != texts[1] - {ILLEGIBLE}


@pytest.mark.parametrize("weather", ["clear", "rain", "night"])
def test_a_window_is_the_crop_of_the_whole_but_for_edges(weather: str) -> None:
    scene = RoadScene(size_px=SMALL, seed=3, weather=weather)
    whole = scene.picture(6)

    part = window(scene, 6, (130, 90, 410, 290))

    apart = np.abs(part.astype(int) - whole[90:290, 130:410])
    assert apart.mean() < 0.5
    assert (apart > 8).mean() < 0.01
    assert np.array_equal(window(scene, 6, (0, 0, *SMALL)), whole)


def test_a_reduced_window_shows_the_means() -> None:
    scene = RoadScene(size_px=SMALL, seed=3, weather="clear")
    whole = scene.picture(6).astype(float)

    small = window(scene, 6, (0, 0, *SMALL), reduce=4)

    means = whole.reshape(90, 4, 160, 4, 3).mean((1, 3))
    assert np.abs(small - means).mean() < 3


def test_a_text_grows_until_it_leaves_the_picture_and_keeps_its_id() -> None:
    scene = RoadScene(seed=50_000, weather="clear")
    heights: dict[int, list[float]] = {}
    names: dict[int, set[str]] = {}

    for index in range(0, 60, 4):
        for quad in scene.quads(index):
            if quad.text.id > 0:
                tall = float(np.linalg.norm(quad.corners[0] - quad.corners[3]))
                heights.setdefault(quad.text.id, []).append(tall)
                names.setdefault(quad.text.id, set()).add(quad.text.text)

    long = [seen for seen in heights.values() if len(seen) >= 5]
    assert long
    assert all(np.all(np.diff(seen) > 0) for seen in long)
    assert all(len(each) == 1 for each in names.values())


def test_what_the_truth_calls_legible_is_tall_and_in_the_picture() -> None:
    scene = RoadScene(seed=50_001, weather="clear")
    counts = []

    for index in range(0, 80, 8):
        truth = scene.truth(index)
        legible = np.array([label != ILLEGIBLE for label in truth.labels], bool)
        tall = truth.boxes[:, 3] - truth.boxes[:, 1]
        counts.append(int(legible.sum()))
        assert (tall[legible] >= LEAST_LEGIBLE_PX - 1).all()
        assert (truth.visibility[legible] >= 0.85).all()
        assert (truth.boxes >= 0).all()
        assert (truth.boxes <= [1280, 720, 1280, 720]).all()

    assert sum(counts) > 10


def test_a_board_behind_a_tree_is_not_to_be_read() -> None:
    scene = RoadScene(seed=4, weather="clear")
    hidden = [q for index in range(0, 80, 4) for q in scene.quads(index) if 0 < q.seen < 0.5]

    assert hidden
    assert not any(q.legible for q in hidden)


def test_texts_in_other_scripts_are_not_to_be_read() -> None:
    scene = RoadScene(seed=4, weather="clear")
    foreign = [q for index in range(0, 80, 8) for q in scene.quads(index) if q.text.foreign]

    assert foreign
    assert not any(q.legible for q in foreign)


def test_the_outline_of_a_text_is_where_its_ink_is() -> None:
    picture, size, texts = board(
        [(1, "EXIT", False)], lettering.fonts()[0], letter_m=0.5, ink=(255, 255, 255),
        ground=(0, 0, 0), light=1.0,
    )  # fmt: skip
    panel = Panel(origin=(0, 2, 10), along=(size[0], 0, 0), down=(0, -size[1], 0), picture=picture)
    h, w = picture.shape[:2]

    left, top, right, low = texts[0].place

    ink = picture[..., 0] > 128
    rows, columns = np.flatnonzero(ink.any(1)), np.flatnonzero(ink.any(0))
    assert (rows[0] / h, columns[0] / w) == pytest.approx((top, left), abs=0.03)
    assert ((rows[-1] + 1) / h, (columns[-1] + 1) / w) == pytest.approx((low, right), abs=0.03)
    assert panel.corners().shape == (4, 3)


def test_a_wider_street_has_more_texts_that_are_no_larger() -> None:
    near, far = (
        RoadScene(seed=2, weather="clear"),
        RoadScene(seed=2, weather="clear", size_px=(7680, 4320)),
    )
    few, many = (
        [q for index in (0, 40) for q in scene.quads(index) if q.legible] for scene in (near, far)
    )

    tallest = [
        max(np.linalg.norm(q.corners[0] - q.corners[3]) for q in each) for each in (few, many)
    ]
    assert len(many) > 2 * len(few)
    assert tallest[1] < 2.5 * tallest[0]


def test_night_is_darker_than_day() -> None:
    day, night = (
        RoadScene(size_px=SMALL, seed=9, weather=weather).picture(0).mean()
        for weather in ("clear", "night")
    )

    assert night < 0.6 * day


def test_a_segment_of_the_street_ends_before_the_next_begins() -> None:
    scene = RoadScene(seed=1)

    walls = [p for side in (0, 1) for p in scene._street.segment(3, side) if p.wall]

    for wall in walls:
        z = wall.corners()[:, 2]
        assert z.min() >= 3 * SEGMENT_M - 1e-9
        assert z.max() <= 4 * SEGMENT_M + 1e-9


def test_the_sensor_opens_it_by_name() -> None:
    scene = open_scene(
        "road", size_px=(0, 0), rate_hz=0, seed=3, length=5, options={"weather": "night"}
    )

    assert scene.size_px == (1280, 720)
    with pytest.raises(IndexError, match="5 frames long"):
        scene.picture(5)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"weather": "snow"}, "weather: expected clear or rain or night or mixed, got 'snow'"),
        ({"size_px": (10, 10)}, "size_px: expected"),
        ({"fonts": "nowhere"}, "nowhere: expected .ttf or .otf files, got none"),
    ],
)
def test_settings_out_of_range_are_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        RoadScene(**options)


def test_a_window_outside_the_picture_is_refused() -> None:
    with pytest.raises(DriverError, match="expected a window inside 640x360"):
        window(RoadScene(size_px=SMALL), 0, (600, 0, 680, 40))


def test_a_font_without_a_glyph_is_refused_by_name() -> None:
    font = next(path for path in lettering.fonts() if path.name == "DejaVuSans.ttf")

    with pytest.raises(SettingsError, match=r"DejaVuSans\.ttf: expected a glyph for '漢'"):
        lettering.check_glyphs(font, "A漢")


def test_a_font_of_ones_own_is_tried_on_all_that_a_street_says_before_it_is_drawn(
    tmp_path: Path,
) -> None:
    whole = next(path for path in lettering.fonts() if path.name == "DejaVuSans.ttf")
    shutil.copy(whole, tmp_path / "whole.ttf")
    RoadScene(fonts=str(tmp_path))
    shutil.copy(whole.with_name("DejaVuSansDisplay.ttf"), tmp_path / "symbols.ttf")

    with pytest.raises(SettingsError, match=r"symbols\.ttf: expected a glyph for '[A-Z]' of '"):
        RoadScene(fonts=str(tmp_path))


def test_a_file_that_is_no_font_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.ttf").write_bytes(b"no font")

    with pytest.raises(SettingsError, match=r"broken\.ttf: expected a font"):
        RoadScene(fonts=str(tmp_path))
