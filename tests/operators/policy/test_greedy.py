"""The greedy policy: where a window gains most, by age of the last look and doubt."""

import tracemalloc
from dataclasses import replace

import numpy as np

from operators.policy import GreedyPolicy, GreedyPolicySettings
from operators.policy.greedy import INSIDE, best_window
from pipeline import Geometry, RoiFeatures, Scanpath, Tracks
from pipeline.boxes import covered
from pipeline.testing import header
from tests.operators.policy.made_up import tracks

# fields of 1920x1080, windows of 480x270
FAR = [(1, 1, 200.0, 200.0, 0.0), (2, 1, 1700.0, 900.0, 0.0)]


def policy(**settings: object) -> GreedyPolicy:
    found = GreedyPolicy(GreedyPolicySettings(**settings))  # type: ignore[arg-type]
    found.open()
    return found


def shown(path: Scanpath, world: Tracks, row: int = 0) -> list[int]:
    """Return ids of the tracks that a row's window shows."""
    inside = covered(world.predicted[:, row], path.boxes[row]) >= 0.8
    return [int(i) for i in world.ids[inside]]


def look(subject: GreedyPolicy, seq: int, *ids: int) -> None:
    features = np.ones((len(ids), 4), np.float32)
    subject.on_features(
        RoiFeatures(
            header=header(seq),
            ids=np.array(ids, np.int32),
            features=features,
            genuine=np.ones(len(ids), np.float32),
        )
    )


def test_every_object_is_shown_again_and_again() -> None:
    subject = policy()
    seen: list[int] = []

    for seq in range(40):
        world = tracks(seq, *FAR)
        path = subject.on_tracks(world)
        look(subject, seq, *seen[-1:])
        seen += shown(path, world)

    assert all(abs(seen[10:].count(each) - 15) <= 2 for each in (1, 2))


def test_a_window_shows_several_where_they_are_near_one_another() -> None:
    world = tracks(0, *FAR, (3, 1, 1450.0, 800.0, 0.0))

    path = policy().on_tracks(world)

    assert shown(path, world) == [2, 3]


def test_a_plan_counts_what_its_earlier_frames_will_have_shown() -> None:
    world = tracks(0, *FAR)

    path = policy().on_tracks(world)

    rows = [shown(path, world, row) for row in range(16)]
    assert {tuple(row) for row in rows} == {(1,), (2,)}


def test_objects_that_overlapped_are_shown_before_others_of_the_same_age() -> None:
    subject = policy(doubt=10.0)
    pair = [(1, 1, 200.0, 200.0, 0.0), (2, 1, 900.0, 500.0, 0.0), (3, 1, 1700.0, 900.0, 0.0)]
    for seq in range(30):
        subject.on_tracks(tracks(seq, *pair))
        look(subject, seq, 1, 2, 3)
    meeting = [pair[0], pair[1], (3, 1, 910.0, 505.0, 0.0)]
    subject.on_tracks(tracks(30, *meeting))
    look(subject, 30, 1, 2, 3)
    apart = tracks(31, *pair)

    path = subject.on_tracks(apart)

    assert shown(path, apart) in ([2], [3])


def test_a_window_that_showed_nobody_is_tried_again() -> None:
    subject = policy(horizon=1)
    first = tracks(0, *FAR)
    aimed = shown(subject.on_tracks(first), first)
    for seq in (0, 1):
        look(subject, seq)

    world = tracks(2, *FAR)

    assert shown(subject.on_tracks(world), world) == aimed


def test_a_late_plan_keeps_what_is_commanded_and_shows_a_doubt_after_it() -> None:
    subject = policy(delay=3, doubt=10.0)
    usual = [*FAR, (3, 1, 900.0, 500.0, 0.0)]
    for seq in range(30):
        before = subject.on_tracks(tracks(seq, *usual))
        look(subject, seq, 1, 2, 3)

    world = tracks(30, *usual, (4, 1, 250.0, 900.0, 0.0))  # somebody new
    path = subject.on_tracks(world)

    np.testing.assert_array_equal(path.boxes[:3], before.boxes[1:4])
    assert shown(path, world, row=3) == [4]


def test_only_objects_of_the_target_class_are_looked_for() -> None:
    subject = policy(target="ball")
    found = set()

    for seq in range(20):
        world = tracks(seq, *FAR, (5, 0, 200.0, 900.0, 0.0))
        found |= set(shown(subject.on_tracks(world), world))

    assert found == {5}


def test_a_box_that_is_no_number_is_not_looked_for() -> None:
    world = tracks(0, *FAR)
    nowhere = world.boxes.copy()
    nowhere[0] = np.nan

    path = policy().on_tracks(replace(world, boxes=nowhere))
    alone = policy().on_tracks(replace(world, boxes=np.full_like(nowhere, np.nan)))

    assert shown(path, world) == [2]
    assert np.isfinite(path.boxes).all()
    np.testing.assert_allclose((alone.boxes[0, :2] + alone.boxes[0, 2:]) / 2, [960, 540], atol=2)


def test_tracks_that_do_not_tell_the_size_of_a_window_get_a_plan_for_a_place() -> None:
    world = tracks(0, *FAR)
    untold = replace(world, header=replace(world.header, geometry=Geometry()))

    path = policy().on_tracks(untold)

    assert not path.boxes.any()
    assert len(path.boxes) == 16


def test_the_probability_of_an_object_is_its_share_of_the_gain() -> None:
    path = policy(target="player").on_tracks(tracks(0, *FAR, (5, 0, 200.0, 900.0, 0.0)))

    np.testing.assert_allclose(path.probability.sum(axis=1), 1, atol=1e-5)
    assert not path.probability[:, 2].any()
    assert set(path.choice.tolist()) == {-1}


def test_a_window_is_one_that_the_sensor_can_address() -> None:
    corner = tracks(0, (1, 1, 5.0, 5.0, 0.0))

    path = policy().on_tracks(corner)

    assert path.boxes[0].tolist() == [0, 0, 480, 270]


def test_another_stream_begins_without_looks() -> None:
    subject = policy()
    subject.on_tracks(tracks(0, *FAR))

    subject.on_stream(header(0))

    assert not len(subject.state().ids)


def test_a_crowd_takes_little_memory_and_gets_the_window_that_gains_most() -> None:
    rng, geometry = np.random.default_rng(0), header(0).geometry
    middle = rng.uniform([700, 400], [1180, 670], (300, 2))
    half = np.array([6, 15])
    boxes = np.concatenate([middle - half, middle + half], 1).astype(np.float32)
    gain = rng.integers(1, 100, 300).astype(np.float64)

    tracemalloc.start()
    window, inside = best_window(boxes, gain, geometry)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert most < 32 * 2**20
    assert (inside == (covered(boxes, window) >= INSIDE)).all()
    around_one = (best_window(each[None], np.ones(1), geometry)[0] for each in boxes)
    assert gain[inside].sum() >= max(gain[covered(boxes, w) >= INSIDE].sum() for w in around_one)
