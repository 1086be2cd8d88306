"""The rule that reads: it shows readable texts until they are read, then searches the field."""

import numpy as np
import pytest

from operators.policy import CentredPolicy, GreedyReadingPolicy, RoundRobinPolicy
from pipeline import Scanpath, SettingsError, Tracks
from pipeline.boxes import covered
from pipeline.contract import inputs_of, settings_of
from pipeline.settings import build
from tests.operators.policy.made_up_texts import STREET, Text, reading, roi, tracks

NEAR, FAR, SMALL = (1, 200.0, 150.0, 20.0), (2, 1100.0, 600.0, 16.0), (3, 640.0, 360.0, 2.0)


def policy(**given: object) -> GreedyReadingPolicy:
    found = GreedyReadingPolicy(build(settings_of(GreedyReadingPolicy), given, "policy"))
    found.open()
    return found


def shown(path: Scanpath, world: Tracks, row: int = 0) -> list[int]:
    """Return ids of the tracks that a row's window shows."""
    return [int(i) for i in world.ids[covered(world.predicted[:, row], path.boxes[row]) >= 0.9]]


def watched(subject: GreedyReadingPolicy, *texts: Text, frames: int = 20) -> list[int]:
    """Return the ids shown frame by frame; the loop reports windows, and nothing is read."""
    found: list[int] = []
    window = np.zeros(4, np.float32)
    for seq in range(frames):
        world = tracks(seq, *texts)
        path = subject.on_tracks(world)
        if window.any():
            subject.on_roi(roi(seq, window))
        window = path.boxes[0]
        found += shown(path, world)
    return found


def test_the_text_that_is_easier_to_read_is_shown_first_and_the_other_next() -> None:
    assert watched(policy(), (1, 200.0, 150.0, 10.0), FAR, frames=2) == [2, 1]


def test_a_plan_shows_every_readable_text() -> None:
    world = tracks(0, NEAR, FAR, SMALL)

    path = policy().on_tracks(world)

    assert {i for row in range(16) for i in shown(path, world, row)} >= {1, 2}
    assert not path.probability[:, 2].any()


def test_a_text_that_was_read_is_worth_nothing_more() -> None:
    subject = policy(verify=0.0)
    world = tracks(0, NEAR, FAR)
    subject.on_tracks(world)
    subject.on_percept(reading(0, world.boxes[:1, -1], 0.95))

    path = subject.on_tracks(tracks(1, NEAR, FAR))

    assert not path.probability[:, 0].any()
    assert shown(path, world) == [2]


def test_a_reading_is_verified_when_nothing_else_is_to_be_read() -> None:
    subject = policy()
    world = tracks(0, NEAR, FAR)
    subject.on_tracks(world)
    subject.on_percept(reading(0, world.boxes[:1, -1], 0.95))

    path = subject.on_tracks(tracks(1, NEAR, FAR))

    assert shown(path, world) == [2]
    assert 1 in [each for row in range(1, 16) for each in shown(path, world, row)]


def test_a_reading_that_is_not_sure_changes_nothing() -> None:
    told, other = policy(sure=0.8), policy(sure=0.8)
    world, following = tracks(0, NEAR, FAR), tracks(1, NEAR, FAR)
    for subject in (told, other):
        subject.on_tracks(world)

    told.on_percept(reading(0, world.boxes[:1, -1], 0.7))

    plans = [subject.on_tracks(following).boxes for subject in (told, other)]
    np.testing.assert_array_equal(*plans)


def test_a_text_that_was_shown_in_vain_is_shown_again_when_it_is_larger() -> None:
    subject = policy()
    watched(subject, (1, 200.0, 150.0, 9.0), frames=4)
    larger = tracks(4, (1, 200.0, 150.0, 16.0))

    path = subject.on_tracks(larger)

    assert shown(path, larger) == [1]


def test_a_text_that_was_shown_in_vain_is_tried_again_later() -> None:
    assert 2 <= watched(policy(least_gain=0.2), NEAR, frames=60).count(1) <= 10


def test_without_readable_texts_the_field_is_searched() -> None:
    subject = policy()

    seen = {tuple(subject.on_tracks(tracks(seq, SMALL)).boxes[0].tolist()) for seq in range(32)}

    windows = np.array(sorted(seen))
    assert len(windows) == 16
    middles = (windows[:, :2] + windows[:, 2:]) / 2
    assert middles.min(0).tolist() == [160, 90]
    assert middles.max(0).tolist() == [STREET.width_px - 160, STREET.height_px - 90]


def test_a_successor_knows_what_was_read() -> None:
    before, after = policy(), policy()
    world = tracks(0, NEAR, FAR)
    before.on_tracks(world)
    before.on_percept(reading(0, world.boxes[:1, -1], 0.95))

    after.restore(before.state())

    assert shown(after.on_tracks(tracks(1, NEAR, FAR)), world) == [2]


def test_another_stream_has_other_texts() -> None:
    subject = policy()
    world = tracks(5, NEAR)
    subject.on_tracks(world)
    subject.on_percept(reading(5, world.boxes[:, -1], 0.95))

    subject.on_stream(world.header)

    assert shown(subject.on_tracks(tracks(0, NEAR)), world) == [1]


def test_a_text_is_planned_again_where_the_sensor_showed_nothing() -> None:
    subject = policy(least_gain=0.2)
    subject.on_tracks(tracks(0, NEAR))
    subject.on_roi(roi(0, np.zeros(4)))
    now, following = tracks(1, NEAR), tracks(2, NEAR)

    assert shown(subject.on_tracks(now), now) == []  # the last plan shows it in this frame
    subject.on_roi(roi(1, np.zeros(4)))
    assert shown(subject.on_tracks(following), following) == [1]


@pytest.mark.parametrize("rule", [RoundRobinPolicy, CentredPolicy])
def test_baselines_have_the_same_inputs(rule: type) -> None:
    assert inputs_of(rule) == inputs_of(GreedyReadingPolicy)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sure": 0.0}, "sure: expected above 0 to 1, got 0"),
        ({"retry": 2.0}, "retry: expected 0 to 1, got 2"),
        ({"verify": 1.1}, "verify: expected 0 to 1, got 1.1"),
        ({"least_gain": -1.0}, "least_gain: expected 0 to 1, got -1"),
        ({"delay": 16}, "delay: expected 0 to below the horizon of 16, got 16"),
        ({"horizon": 0}, "horizon: expected 1 to 1000, got 0"),
        ({"horizon": 1001}, "horizon: expected 1 to 1000, got 1001"),
    ],
)
def test_settings_out_of_range_are_refused(given: dict[str, float], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        policy(**given)
