"""Tiles of a large context: one answer per frame, in sensor pixels, of all that was seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency import MovedSaliency, Saliency
from operators.saliency.moved import RAISE_AFTER, MovedSaliencySettings, TileBudget
from operators.saliency.saliency import SHIPPED
from pipeline import Detections, Frame, SettingsError
from pipeline.testing import drive, header
from tests.operators.networks import constant_network

CONTEXT, SENSOR = (960, 576), (7680, 4608)  # 2 x 2 tiles, 3 x 3 with an overlap


def frame(seq: int, pixels: NDArray[np.uint8]) -> Frame:
    return Frame(header=header(seq), pixels=pixels, window=(0, 0, *SENSOR))


def flat(level: int = 80) -> NDArray[np.uint8]:
    return np.full((CONTEXT[1], CONTEXT[0], 3), level, np.uint8)


def answers(frames: list[Frame], weights: str, **settings: object) -> list[Detections]:
    found = drive(MovedSaliency, frames, {"weights": weights, **settings})
    return [answer for answer in found if isinstance(answer, Detections)]


@pytest.fixture
def one_in_each(tmp_path: Path) -> str:
    """A network that finds a player in the middle of every tile, and features of one channel."""
    output = np.zeros((1, 6, 64), np.float32)
    output[0, :, 0] = (240, 144, 10, 20, 0.9, 0)
    features = np.arange(36 * 60, dtype=np.float32).reshape(1, 1, 36, 60)
    return constant_network(
        tmp_path / "n.onnx", output, features=features, names="{0: 'player', 1: 'ball'}"
    )


def test_what_each_tile_finds_is_told_once_in_sensor_pixels(one_in_each: str) -> None:
    (found,) = answers([frame(0, flat())], one_in_each, tiles=100, overlap_px=0)

    middles = (found.boxes[:, :2] + found.boxes[:, 2:]) / 2
    expected = [[x, y] for y in (1152, 3456) for x in (1920, 5760)]
    assert sorted(middles.tolist(), key=lambda p: (p[1], p[0])) == expected
    assert np.allclose(found.boxes[:, 2:] - found.boxes[:, :2], [80, 160])
    assert found.features.shape == (4, 1)
    assert found.features[0, 0] > 0


def test_no_more_tiles_are_looked_at_than_set_and_all_within_some_frames(one_in_each: str) -> None:
    found = answers([frame(k, flat()) for k in range(4)], one_in_each, tiles=3, overlap_px=48)

    assert [len(answer.boxes) for answer in found] == [3, 6, 9, 9]


def test_what_was_seen_is_told_again_where_nothing_moved(one_in_each: str) -> None:
    first, second = answers(
        [frame(0, flat()), frame(1, flat())], one_in_each, tiles=4, overlap_px=0
    )

    assert np.array_equal(first.boxes, second.boxes)
    assert np.array_equal(first.features, second.features)


def test_what_two_tiles_find_on_both_sides_of_their_border_counts_once(tmp_path: Path) -> None:
    # beside the right border and, the same person a pixel off, beside the left one
    output = np.zeros((1, 6, 64), np.float32)
    output[0, :, 0], output[0, :, 1] = (479, 144, 10, 20, 0.9, 0), (1, 144, 10, 20, 0.8, 0)
    weights = constant_network(tmp_path / "n.onnx", output, names="{0: 'player', 1: 'ball'}")

    (found,) = answers([frame(0, flat())], weights, tiles=4, overlap_px=0)

    x = (found.boxes[:, 0] + found.boxes[:, 2]) / 16
    assert len(found.boxes) == 6  # two in each row of tiles at the border would be eight
    assert np.abs(x - 480).min() < 2


def test_a_context_of_another_size_begins_anew(one_in_each: str) -> None:
    small = Frame(
        header=header(1), pixels=np.full((270, 480, 3), 9, np.uint8), window=(0, 0, 1920, 1080)
    )

    first, second = answers([frame(0, flat()), small], one_in_each, tiles=4, overlap_px=0)

    assert (len(first.boxes), len(second.boxes)) == (4, 1)


def test_another_stream_begins_anew(one_in_each: str) -> None:
    subject = MovedSaliency(MovedSaliencySettings(weights=one_in_each, tiles=1, overlap_px=0))
    subject.open()
    subject.on_stream(header(0))
    before = [len(subject.on_frame(frame(k, flat())).boxes) for k in range(3)]

    subject.on_stream(replace(header(3), stream="another"))

    assert (before, len(subject.on_frame(frame(3, flat())).boxes)) == ([1, 2, 3], 1)


def roi(*window: int) -> Frame:
    return Frame(header=header(0), pixels=np.zeros((8, 8, 3), np.uint8), window=window)  # type: ignore[arg-type]


def around(x: int, y: int, left: int = 0, top: int = 0) -> Frame:
    """A ROI with its middle there in the context, which begins at `left`, `top` of the sensor."""
    return roi(
        left + 8 * x - 240, top + 8 * y - 144, left + 8 * x + 240, top + 8 * y + 144
    )  # fmt: skip


NO_ROI = Frame(header=header(0), pixels=np.zeros((0, 0, 3), np.uint8), window=(0, 0, 0, 0))


def found_at(
    given_to: list[Frame | dict[str, Frame]], weights: str, **rules: int
) -> list[list[list[float]]]:
    """Middles of what is found in each frame, context pixels; one tile in each beside the ROI's."""
    answers = drive(
        MovedSaliency, given_to, {"weights": weights, "tiles": 1, "overlap_px": 0} | rules
    )
    return [
        ((answer.boxes[:, :2] + answer.boxes[:, 2:]) / 16).tolist()
        for answer in answers
        if isinstance(answer, Detections)
    ]


def test_a_tile_at_the_roi_is_looked_at_in_every_frame_beside_the_others(one_in_each: str) -> None:
    middles = [[432, 208], [464, 208], [496, 208]]  # of whole cells of 32 pixels
    sent: list[Frame | dict[str, Frame]] = []
    for k, (x, y) in enumerate(middles):
        sent += [{"roi": around(x, y)}, frame(k, flat())]

    found = found_at(sent, one_in_each)

    assert [middle in places for middle, places in zip(middles, found, strict=True)] == [True] * 3
    # what it showed a frame before is no more
    assert [sum(place[1] == 208 for place in places) for places in found] == [1, 1, 1]


def test_while_the_roi_moves_by_less_than_a_cell_its_tile_stays(one_in_each: str) -> None:
    sent: list[Frame | dict[str, Frame]] = []
    for k, x in enumerate((425, 432, 439)):
        sent += [{"roi": around(x, 208)}, frame(k, flat())]

    assert [[432, 208] in places for places in found_at(sent, one_in_each)] == [True] * 3


def test_the_tile_at_the_roi_replaces_what_overlapping_tiles_found_there(one_in_each: str) -> None:
    sent = [frame(0, flat()), {"roi": around(496, 304)}, frame(1, flat())]

    before, after = found_at(sent, one_in_each, tiles=9, overlap_px=48)

    assert [480, 288] in before  # the middle one of nine
    assert [480, 288] not in after
    assert [496, 304] in after
    assert len(after) == len(before) == 9


def test_where_the_roi_ends_with_the_picture_so_does_its_tile(one_in_each: str) -> None:
    sent = [{"roi": roi(2880, 1728, 7680, 4608)}, frame(0, flat())]

    assert [960 - 240, 576 - 144] in found_at(sent, one_in_each)[0]


def test_the_roi_is_found_in_a_context_that_shows_a_part_of_the_sensor(one_in_each: str) -> None:
    part = Frame(header=header(0), pixels=flat(), window=(800, 400, 800 + 7680, 400 + 4608))

    (answer,) = drive(
        MovedSaliency,
        [{"roi": around(432, 208, 800, 400)}, part],
        {"weights": one_in_each, "tiles": 1, "overlap_px": 0},
    )[1:]

    assert isinstance(answer, Detections)
    middles = (answer.boxes[:, :2] + answer.boxes[:, 2:]) / 2
    assert [800 + 8 * 432, 400 + 8 * 208] in middles.tolist()


@pytest.mark.parametrize(
    "last", [NO_ROI, roi(8000, 5000, 8480, 5288)], ids=["no ROI", "outside of the context"]
)
def test_without_a_roi_in_the_context_the_tiles_are_as_they_were(
    last: Frame, one_in_each: str
) -> None:
    sent = [{"roi": around(432, 208)}, {"roi": last}, frame(0, flat())]

    assert found_at(sent, one_in_each) == found_at([frame(0, flat())], one_in_each)


def test_a_context_that_does_not_say_what_it_shows_has_no_tile_at_the_roi(one_in_each: str) -> None:
    unsaid = Frame(header=header(0), pixels=flat(), window=(0, 0, 0, 0))

    with_roi = found_at([{"roi": around(432, 208)}, unsaid], one_in_each)

    assert with_roi == found_at([unsaid], one_in_each)


def test_another_stream_has_another_roi(one_in_each: str) -> None:
    other = replace(frame(0, flat()), header=replace(header(0), stream="another"))
    sent = [{"roi": around(432, 208)}, other]

    assert found_at(sent, one_in_each) == found_at([other], one_in_each)


def tiles_at(seqs: list[int], *, least: int, most: int) -> list[int]:
    budget, found = TileBudget(tiles=most), []
    for seq in seqs:
        budget = budget.after(seq, least, most)
        found.append(budget.tiles)
    return found


def test_missed_frames_cost_a_quarter_of_the_tiles_and_one_at_least() -> None:
    assert tiles_at([0, 2, 4, 6], least=1, most=8) == [8, 6, 5, 4]
    assert tiles_at(list(range(0, 40, 2)), least=2, most=8)[-1] == 2


def test_after_fifteen_frames_without_a_gap_there_is_one_tile_more() -> None:
    found = tiles_at([0, 2, *range(3, 3 + 3 * RAISE_AFTER)], least=1, most=8)

    assert RAISE_AFTER == 15
    assert found[1] == 6
    assert found[RAISE_AFTER : RAISE_AFTER + 2] == [6, 7]
    assert found[-1] == 8


def test_without_a_gap_there_are_all_tiles_always() -> None:
    assert set(tiles_at(list(range(100)), least=1, most=8)) == {8}


@given(st.lists(st.integers(-3, 4), max_size=100), st.integers(1, 8), st.integers(0, 8))
def test_the_tiles_stay_within_what_is_set(steps: list[int], least: int, more: int) -> None:
    seqs = np.cumsum([0, *steps]).tolist()

    found = tiles_at(seqs, least=least, most=least + more)

    assert all(least <= tiles <= least + more for tiles in found)


@pytest.mark.parametrize(("least", "expected"), [(0, [4, 8, 9]), (1, [4, 7, 9])])
def test_after_a_gap_fewer_tiles_are_looked_at_where_the_graph_allows_it(
    one_in_each: str, least: int, expected: list[int]
) -> None:
    sent = [frame(seq, flat()) for seq in (0, 2, 4)]

    found = answers(sent, one_in_each, tiles=4, overlap_px=48, least_tiles=least)

    assert [len(answer.boxes) for answer in found] == expected


def test_an_empty_picture_is_no_gap(one_in_each: str) -> None:
    empty = Frame(header=header(1), pixels=np.zeros((0, 0, 3), np.uint8), window=(0, 0, 0, 0))

    found = answers(
        [frame(0, flat()), empty, frame(2, flat())],
        one_in_each, tiles=4, overlap_px=48, least_tiles=1,
    )  # fmt: skip

    assert [len(answer.boxes) for answer in found] == [4, 0, 8]


def test_another_stream_begins_with_all_tiles(one_in_each: str) -> None:
    other = [replace(frame(k, flat()), header=replace(header(k), stream="b")) for k in (0, 1)]
    sent = [*(frame(seq, flat()) for seq in (0, 2, 4)), *other]

    found = answers(sent, one_in_each, tiles=4, overlap_px=48, least_tiles=1)

    assert [len(answer.boxes) for answer in found] == [4, 7, 9, 4, 8]


def test_an_empty_picture_finds_nothing(one_in_each: str) -> None:
    empty = Frame(header=header(0), pixels=np.zeros((0, 0, 3), np.uint8), window=(0, 0, 0, 0))

    (found,) = answers([empty], one_in_each)

    assert len(found.boxes) == 0


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("tiles", 0, "tiles: must be at least 1, got 0"),
        ("overlap_px", 300, r"overlap_px: must be within 0\.\.256, got 300"),
        ("least_tiles", 9, r"least_tiles: must be within 0\.\.8 \(tiles\), got 9"),
        ("change_levels", 0, "change_levels: must be above 0 and below 255, got 0"),
        ("refresh_frames", 0, "refresh_frames: must be at least 1, got 0"),
        ("nms_iou", 2, r"nms_iou: must be within 0\.\.1, got 2"),
    ],
)
def test_a_setting_out_of_range_is_refused(name: str, value: float, sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        MovedSaliencySettings(**{name: value})  # type: ignore[arg-type]


def test_an_overlap_as_large_as_a_tile_is_refused(tmp_path: Path) -> None:
    output = np.zeros((1, 6, 64), np.float32)
    weights = constant_network(tmp_path / "n.onnx", output, size_px=(128, 96))
    settings = MovedSaliencySettings(weights=weights, overlap_px=96)

    with pytest.raises(SettingsError, match=r"overlap_px: must be below the sides of a tile"):
        list(MovedSaliency.advise(settings, {}))


def test_the_shipped_detector_sees_in_tiles_what_it_sees_in_the_whole() -> None:
    """One tile is what `Saliency` would look at."""
    pixels = np.random.default_rng(1).integers(0, 256, (288, 480, 3)).astype(np.uint8)
    given = Frame(header=header(0), pixels=pixels, window=(0, 0, 480, 288))
    low = {"weights": str(SHIPPED), "confidence": 0.02}

    (tile,) = drive(MovedSaliency, [given], low)
    (whole,) = drive(Saliency, [given], low)

    assert isinstance(tile, Detections)
    assert isinstance(whole, Detections)
    assert np.array_equal(tile.boxes, whole.boxes)
