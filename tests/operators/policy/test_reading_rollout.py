"""Roll-outs of the policy that reads: windows, a simulated reader, and what a choice reads."""

from pathlib import Path

import numpy as np
import pytest

from operators.policy.looks import carried, exposed, no_looks, noted
from operators.policy.reading.gain import VERIFY
from operators.policy.reading.rollout import Episode, Task, roll, tasks, teacher
from operators.policy.reading.street import SimulatedReader, Street
from operators.policy.reading.tokens import LOOKS, encode_texts
from operators.policy.reading.utility import DISCOUNT, expected, marginal
from operators.policy.rollout import Late
from pipeline.boxes import covered
from tests.operators.policy.made_up_texts import reading, tracks
from tests.operators.policy.recorded_texts import FOREIGN, ROI, SIGNS, street

LEFT = np.array([60, 90, 380, 270], np.float32)  # shows the signs 1 and 3


def test_only_texts_with_a_transcription_are_to_be_read(tmp_path: Path) -> None:
    clip = street(tmp_path)

    assert clip.ids[clip.counts].tolist() == [101, 102, 103]
    assert not clip.chance[:, ~clip.counts].any()


def test_a_smaller_roi_shows_fewer_texts_at_once(tmp_path: Path) -> None:
    recording = street(tmp_path).recording

    shown = []
    for scale in (1.0, 0.4):
        clip = Street(recording, scale)
        tracked, looks = clip.moment(0).tracks, carried(no_looks(), clip.moment(0).tracks)
        path = encode_texts(tracked, looks, np.zeros((4, 4, 2), np.float32), sure=0.8).path[:, 0]
        shown.append(sum(int((covered(tracked.boxes[:, -1], one) == 1).sum()) for one in path[:4]))

    assert shown == [6, 4]


def test_the_reader_reads_what_the_window_shows_and_reports_it_from_then_on(tmp_path: Path) -> None:
    reader = SimulatedReader(street(tmp_path), seed=1)

    for frame in range(8):
        reader.look(LEFT, frame)
    percept = reader.look(np.array([900, 500, 1220, 680], np.float32), 8)

    assert reader.read[[0, 2]].all()
    assert {101, 103} <= set(percept.ids.tolist()) <= {101, 102, 103}
    assert (reader.shown_at[[0, 2]] == 0).all()


def test_the_reader_has_the_same_luck_for_the_same_seed(tmp_path: Path) -> None:
    clip = street(tmp_path)

    found = [
        [SimulatedReader(clip, seed).look(LEFT, 3).scores.tolist() for _ in range(2)]
        for seed in (1, 2)
    ]

    assert found[0][0] == found[0][1]
    assert found[0] != found[1]


def test_a_window_around_one_text_shows_its_neighbour_as_well(tmp_path: Path) -> None:
    world = tracks(0, *SIGNS, FOREIGN, channels=2)
    looks = carried(no_looks(), world)

    texts = encode_texts(world, looks, np.zeros((4, 4, 2), np.float32), sure=0.8)

    for step in (0, 15):
        assert (covered(world.predicted[[0, 2], step], texts.path[0, step]) == 1).all()
    assert covered(world.predicted[1:2, 0], texts.path[1, 0])[0] == 1
    assert texts.looks.shape == (5, LOOKS)
    assert texts.ids.tolist() == [1, 2, 3, 4, -1]


def test_the_rule_promises_less_where_a_text_was_read_and_nothing_where_it_was_just_shown() -> None:
    world = tracks(0, *SIGNS)
    fresh = carried(no_looks(), world)
    read = noted(fresh, reading(0, world.boxes[1:2, -1], 0.9))
    shown = exposed(fresh, world.boxes[1, -1] + np.array([-9, -9, 9, 9], np.float32), 0)
    roi = np.zeros((3, 4, 2), np.float32)

    rules = [encode_texts(world, looks, roi, sure=0.8).rule for looks in (fresh, read, shown)]

    assert rules[0][1, 0] > 0.7
    assert rules[1][1, 0] == pytest.approx(VERIFY * rules[0][1, 0])
    assert rules[2][1, 0] < 0.05
    assert (rules[0][0] == rules[0][2]).all()  # one window shows both
    assert rules[0][0, 0] > 1.2


def test_a_plan_by_the_rule_turns_to_what_it_has_not_shown() -> None:
    world = tracks(0, *SIGNS)

    rule = encode_texts(
        world, carried(no_looks(), world), np.zeros((3, 4, 2), np.float32), sure=0.8, delay=2
    ).rule

    assert rule[:3, :5].argmax(0).tolist() == [0, 0, 0, 1, 0]


def test_a_plan_is_worth_the_texts_that_it_is_expected_to_read() -> None:
    reads = np.zeros((2, 2, 3), np.float32)
    reads[0, 0], reads[1, 1] = 0.5, 1.0
    first, turns = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.float32)
    first[0] = 1
    turns[[0, 1, 0], [0, 1, 2]] = 1

    # one text twice: .5 and a half of the rest; one that was read is worth nothing more
    unread = np.ones(2, np.float32)
    assert expected(reads, unread, first) == pytest.approx(
        0.5 + DISCOUNT * 0.25 + DISCOUNT**2 * 0.125
    )
    assert expected(reads, unread, turns) == pytest.approx(0.5 + DISCOUNT + DISCOUNT**2 * 0.25)


def test_the_greedy_plan_gains_nothing_from_a_text_that_it_has_read() -> None:
    reads = np.zeros((2, 2, 2), np.float32)
    reads[0, 0], reads[1, 1] = 1.0, 0.5

    assert marginal(reads, np.ones(2, np.float32)).tolist() == [[1, 0], [0.5, 0.5]]


def test_a_teacher_that_knows_the_truth_reads_everything_soon(tmp_path: Path) -> None:
    clip = street(tmp_path)
    episode = Episode(clip, Task(clip=0, start=0, seed=4), ROI)
    rng = np.random.default_rng(0)

    samples = roll([episode], teacher([episode], 0.0, rng), frames=20, how="argmax", rng=rng)

    assert episode.reader.read.tolist() == [True, True, True, False]
    assert episode.reader.read_at.max() <= 12
    assert samples[0].reads.shape == (5, 3, 16)
    assert len(samples) < 15  # moments with nothing left to read are left out


def test_a_text_that_was_read_has_no_utility_left(tmp_path: Path) -> None:
    episode = Episode(street(tmp_path), Task(clip=0, start=0), ROI)
    episode.look()
    before = episode.reads()[0].shape[1]

    episode.reader.read_at[:] = 0

    assert (before, episode.reads()[0].size) == (3, 0)


def test_tasks_are_the_same_for_the_same_seed_and_end_within_their_clip(tmp_path: Path) -> None:
    clips = [street(tmp_path)]

    found = tasks(clips, 50, frames=10, seed=3, late=Late())

    assert found == tasks(clips, 50, frames=10, seed=3, late=Late())
    assert max(task.start for task in found) == 14
    assert {task.delay for task in found} == {0, 1, 2, 4}
