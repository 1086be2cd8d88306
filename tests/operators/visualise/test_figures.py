"""Latency, raster, plans and log lines: from messages to what is plotted."""

from dataclasses import replace

import numpy as np
import pytest

from operators.visualise.events import MOST_LINES, SETTLED, Events
from operators.visualise.field import MOST_RIMS, dashed, paths, planned
from operators.visualise.figures import REMEMBERED, LoopLatency, Target
from operators.visualise.pictures import same_window
from operators.visualise.raster import DARK, MOST_ROWS, PAST_FRAMES, ScanpathRaster
from pipeline import Frame, Percept, RoiSchedule, Scanpath, Span, Tracks
from pipeline.testing import header, picture

BOX = np.array([[100, 100, 140, 160]], np.float32)


def timed(seq: int, age_ms: int):
    """Return the header of a command that was made so long after its picture."""
    told = header(seq)
    done_ns = told.stamp_ns + age_ms * 1_000_000
    span = Span(stage="dispatch", received_ns=done_ns, done_ns=done_ns, handler_ns=0,
                scheduling_delay_ns=0)  # fmt: skip
    return replace(told, trace=(span,))


def test_the_loop_is_judged_by_one_and_two_periods_of_its_source():
    loop = LoopLatency()

    for seq in range(100):
        loop.add(timed(seq, 80 if seq == 50 else 20))

    figures = loop.figures()
    assert figures["p50"] == pytest.approx(20)
    assert figures["p99"] > 20
    assert figures["budget_p50"] == pytest.approx(33.333, abs=0.01)
    assert figures["budget_p99"] == pytest.approx(66.667, abs=0.01)


def test_a_loop_without_times_has_no_figures():
    loop = LoopLatency()

    loop.add(header(0))

    assert loop.figures() == {}


@pytest.mark.parametrize(("shift_px", "numbers"), [(0, ["+1 to +16"]), (20, ["+1", "+16"])])
def test_a_plan_is_some_windows_numbered_at_its_ends(shift_px, numbers):
    windows = np.array([[0, 0, 480, 270]], np.int32) + np.arange(16, dtype=np.int32)[:, None] * (
        np.array([shift_px, 0, shift_px, 0], np.int32)
    )

    found = planned(RoiSchedule(header=header(9), first_seq=10, windows=windows))

    assert list(found.numbers) == numbers
    assert len(found.boxes) == MOST_RIMS
    assert found.boxes[[0, -1]].tolist() == windows[[0, -1]].tolist()
    assert found.colours.sum(1).tolist() == sorted(found.colours.sum(1).tolist(), reverse=True)


def test_a_plan_without_a_window_draws_nothing():
    windows = np.zeros((4, 2, 4), np.int32)

    found = planned(RoiSchedule(header=header(0), first_seq=1, windows=windows))

    assert (len(found.boxes), list(found.numbers)) == (0, [])


def test_a_predicted_path_fades():
    boxes = np.repeat(BOX[:, None], 4, axis=1)
    tracks = Tracks(header=header(), ids=np.ones(1, np.int32), labels=np.zeros(1, np.int32),
                    scores=np.ones(1, np.float32), boxes=boxes, visible=np.ones((1, 4), np.bool_),
                    features=np.zeros((1, 4, 0), np.float32), predicted=boxes + 8,
                    names=("ball",))  # fmt: skip

    steps, colours = paths(tracks)

    assert steps.shape == (4, 2, 2)
    assert steps[0].tolist() == [[120, 130], [128, 138]]
    assert colours[0].tolist() == [255, 120, 0]
    assert all(a > b for a, b in zip(colours[:-1, 0], colours[1:, 0], strict=True))


def test_dashes_of_no_boxes_are_none():
    assert dashed(BOX[:0]).shape == (0, 2, 2)


def test_the_window_of_the_context_is_enlarged_and_black_outside():
    pixels = picture(4, 8, seed=0)
    context = Frame(header=header(), pixels=pixels, window=(0, 0, 80, 40))

    shown = same_window(context, (60, 20, 100, 40), (40, 20))

    assert (shown[5, 5] == pixels[2, 6, ::-1]).all()
    assert (shown[15, 15] == pixels[3, 7, ::-1]).all()
    assert not shown[:, 20:].any()


def test_the_raster_shows_past_and_plan_of_the_likeliest_objects():
    raster = ScanpathRaster()
    ids = np.arange(12, dtype=np.int32)
    probability = np.zeros((16, 12), np.float32)
    probability[:, :10] = 0.02
    probability[:, 3] = 0.8

    for seq in range(200):
        shown = raster.add(
            Scanpath(header=header(seq), ids=ids, probability=probability,
                     choice=np.full(16, 3, np.int32), boxes=np.repeat(BOX, 16, 0),
                     first_seq=seq + 1)
        )  # fmt: skip

    assert len(shown.ids) == MOST_ROWS
    assert shown.shades.shape == (MOST_ROWS, PAST_FRAMES + 16, 3)
    row = shown.ids.index(3)
    assert 11 not in shown.ids  # it is never looked at
    others = np.delete(shown.shades, row, 0).astype(int)
    assert (shown.shades[row].astype(int).sum(-1) > others.sum(-1).max() + 100).all()


def test_a_raster_without_objects_is_dark():
    nothing = Scanpath(
        header=header(), ids=np.zeros(0, np.int32), probability=np.zeros((0, 0), np.float32),
        choice=np.zeros(0, np.int32), boxes=np.zeros((0, 4), np.float32), first_seq=1,
    )  # fmt: skip

    assert (ScanpathRaster().add(nothing).shades == DARK).all()


def test_what_is_remembered_of_frames_is_bounded():
    target = Target()

    for seq in range(500):
        target.add_roi("roi", Frame(header=header(seq), pixels=picture(2, 2, seed=0)))

    assert len(target._windows) <= REMEMBERED


def test_a_loss_is_told_once_it_lasts():
    events = Events()
    none = np.zeros(0, np.float32)
    seen = Percept(header=header(), boxes=BOX, ids=np.ones(1, np.int32), scores=np.ones(1, "f4"))
    lost = Percept(header=header(), boxes=BOX[:0], ids=np.ones(0, np.int32), scores=none)

    told = [
        list(events.answered(percept))
        for percept in (*[seen] * SETTLED, lost, seen, *[lost] * SETTLED)
    ]

    assert [line for lines in told for line in lines] == [
        "the consumer has its object",
        "the consumer lost its object",
    ]


def test_a_text_is_told_when_it_is_read_not_in_every_answer() -> None:
    events = Events()

    told = [list(events.transcribed(texts)) for texts in
            (("EXIT",), ("EXIT",), ("EXIT", "BAR"), (), ("BAR",))]  # fmt: skip

    assert told == [["read: EXIT"], [], ["read: BAR"], [], ["read: BAR"]]


def test_the_lines_of_the_log_are_limited_and_what_is_left_out_is_counted():
    events = Events()

    allowed = [events.allowed(0) for _ in range(MOST_LINES + 5)]

    assert allowed == [0] * MOST_LINES + [None] * 5
    assert events.allowed(1000) == 5
