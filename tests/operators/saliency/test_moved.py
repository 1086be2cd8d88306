"""Tiles of a large context: one answer per frame, in sensor pixels, of all that was seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency import MovedSaliency, Saliency, moved
from operators.saliency.moved import RAISE_AFTER, Effort, MovedSaliencySettings, look
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


def looking_at(weights: str, **settings: int) -> MovedSaliency:
    """One tile in each frame, and whatever lies around the ROI."""
    rules = {"tiles": 1, "overlap_px": 0} | settings
    subject = MovedSaliency(MovedSaliencySettings(weights=weights, **rules))  # type: ignore[arg-type]
    subject.open()
    subject.on_stream(header(0))
    return subject


def roi(*window: int) -> Frame:
    return Frame(header=header(0), pixels=np.zeros((8, 8, 3), np.uint8), window=window)  # type: ignore[arg-type]


def around(x: float, y: float) -> Frame:
    """An ROI whose middle is there in the context."""
    return roi(int(8 * x) - 240, int(8 * y) - 144, int(8 * x) + 240, int(8 * y) + 144)


def found_at(subject: MovedSaliency, seq: int) -> list[list[float]]:
    """Middles of what is found in a flat picture, context pixels."""
    boxes = subject.on_frame(frame(seq, flat())).boxes
    return ((boxes[:, :2] + boxes[:, 2:]) / 16).tolist()


def test_a_tile_around_the_roi_is_looked_at_in_every_frame_beside_the_others(
    one_in_each: str,
) -> None:
    subject = looking_at(one_in_each)
    middles = [[432.0, 208.0], [464.0, 208.0], [496.0, 208.0]]  # of whole cells of 32 pixels
    found = []
    for k, (x, y) in enumerate(middles):
        subject.on_roi(around(x, y))
        found.append(found_at(subject, k))

    assert [middle in places for middle, places in zip(middles, found, strict=True)] == [True] * 3
    # what it showed a frame ago is no more: each frame has one more of the four tiles, at most
    assert [sum(place[1] == 208 for place in places) for places in found] == [1, 1, 1]


def test_while_the_roi_moves_by_less_than_a_cell_its_tile_stays(one_in_each: str) -> None:
    subject = looking_at(one_in_each)
    found = []
    for k, x in enumerate((425.0, 432.0, 439.0)):
        subject.on_roi(around(x, 208))
        found.append([432.0, 208.0] in found_at(subject, k))

    assert found == [True, True, True]


def test_at_the_border_the_tile_around_the_roi_ends_where_the_picture_does(
    one_in_each: str,
) -> None:
    subject = looking_at(one_in_each)

    subject.on_roi(roi(7600, 4500, 7680, 4608))

    assert [960 - 240, 576 - 144] in found_at(subject, 0)


def test_a_sensor_that_read_no_roi_leaves_the_tiles_alone(one_in_each: str) -> None:
    subject, without = looking_at(one_in_each), looking_at(one_in_each)
    subject.on_roi(roi(3200, 1600, 3680, 1888))
    empty = Frame(header=header(0), pixels=np.zeros((0, 0, 3), np.uint8), window=(0, 0, 0, 0))
    subject.on_roi(empty)

    assert found_at(subject, 0) == found_at(without, 0)


def test_another_stream_has_another_roi(one_in_each: str) -> None:
    subject, without = looking_at(one_in_each), looking_at(one_in_each)
    subject.on_roi(roi(3200, 1600, 3680, 1888))
    subject.on_stream(replace(header(0), stream="another"))

    assert found_at(subject, 0) == found_at(without, 0)


def test_a_context_that_does_not_say_what_it_shows_is_no_end(one_in_each: str) -> None:
    subject = looking_at(one_in_each)
    subject.on_roi(roi(3200, 1600, 3680, 1888))

    found = subject.on_frame(Frame(header=header(0), pixels=flat(), window=(0, 0, 0, 0)))

    assert len(found.boxes)


def tiles_at(seqs: list[int], *, least: int, most: int) -> list[int]:
    effort, found = Effort(tiles=most), []
    for seq in seqs:
        effort = effort.after(seq, least, most)
        found.append(effort.tiles)
    return found


def test_missed_frames_cost_a_quarter_of_the_tiles_and_one_at_least() -> None:
    assert tiles_at([0, 2, 4, 6], least=1, most=8) == [8, 6, 5, 4]
    assert tiles_at(list(range(0, 40, 2)), least=2, most=8)[-1] == 2


def test_who_keeps_up_tries_one_tile_more_after_a_while() -> None:
    kept_up = tiles_at([0, 2, *range(3, 3 + 3 * RAISE_AFTER)], least=1, most=8)

    assert kept_up[1] == 6
    assert kept_up[1 + RAISE_AFTER : 3 + RAISE_AFTER] == [7, 7]
    assert kept_up[-1] == 8


def test_who_misses_nothing_looks_at_all_tiles_always() -> None:
    assert set(tiles_at(list(range(100)), least=1, most=8)) == {8}


@given(
    st.lists(st.integers(1, 4), max_size=100), st.integers(1, 8), st.integers(0, 8)
)  # fmt: skip
def test_the_tiles_stay_within_what_is_set_and_depend_on_the_frames_alone(
    steps: list[int], least: int, more: int
) -> None:
    seqs = np.cumsum([0, *steps]).tolist()

    found = tiles_at(seqs, least=least, most=least + more)

    assert all(least <= tiles <= least + more for tiles in found)
    assert found == tiles_at(seqs, least=least, most=least + more)


@pytest.mark.parametrize(("least", "expected"), [(0, [4, 4, 4]), (1, [4, 3, 2])])
def test_fewer_tiles_are_looked_at_only_where_the_graph_allows_it(
    one_in_each: str, least: int, expected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = []
    monkeypatch.setattr(moved, "look", lambda *part: looks.append(part) or look(*part))
    subject = looking_at(one_in_each, tiles=4, least_tiles=least)
    counts = []
    for k, level in enumerate((80, 120, 160)):  # all four tiles change from frame to frame
        looks.clear()
        subject.on_frame(frame(2 * k, flat(level)))
        counts.append(len(looks))

    assert counts == expected


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
