"""The template tracker, with the shipped network and with one that learned nothing."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.scenes.soccer import SoccerScene
from operators.tracker import TemplateTracker, TemplateTrackerSettings
from operators.tracker.look import Streams
from operators.tracker.template import SHIPPED, Template, decode, shape_of
from operators.tracker.vittrack import VitTrack
from pipeline import Frame, WeightsError
from pipeline.boxes import iou
from pipeline.errors import SettingsError
from pipeline.messages import altered
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import World

AT = np.zeros((1, 2, 16, 16), np.float32)


def test_place_and_size_are_decoded_at_the_best_cell():
    heat = np.zeros((1, 1, 16, 16), np.float32)
    heat[0, 0, 4, 8] = 0.9

    centre, size = decode(heat, AT + 0.25, AT - 0.5, np.ones((16, 16), np.float32))

    np.testing.assert_allclose(centre * 16, [8, 4])
    np.testing.assert_allclose(size, [0.25, 0.25])


def test_of_two_equal_peaks_the_one_nearer_to_the_middle_is_taken():
    heat = np.zeros((1, 1, 16, 16), np.float32)
    heat[0, 0, 8, 8] = heat[0, 0, 1, 1] = 0.5
    window = np.zeros((16, 16), np.float32)
    window[8, 8] = 1

    centre, _ = decode(heat, AT + 0.25, AT, window)

    np.testing.assert_allclose(centre * 16, [8.5, 8.5])


def test_the_shape_of_an_empty_box_is_a_number():
    assert np.isfinite(shape_of(np.array([5, 5, 5, 5], np.float32))).all()


def test_the_shipped_network_follows_a_moving_object_from_frame_to_frame():
    world, tracker = World(seed=3), Template()
    box = world.box(0)
    tracker.start(Streams(**world.frames(0)), box)

    found = []
    for seq in range(1, 25):
        box, _ = tracker.follow(Streams(**world.frames(seq)), box)
        found.append(iou(box[None], world.box(seq)[None])[0, 0])

    assert np.mean(found) > 0.5


def test_where_no_picture_shows_the_surroundings_the_box_stays():
    world, tracker = World(seed=3), Template()
    tracker.start(Streams(**world.frames(0)), world.box(0))
    dark = {
        name: altered(frame, pixels=np.zeros_like(frame.pixels))
        for name, frame in world.frames(1).items()
    }

    box, score = tracker.follow(Streams(**dark), world.box(0))

    assert (box.tolist(), score) == (world.box(0).tolist(), 0)


def drawn(scene, seq):
    picture = np.array(scene.picture(seq))
    small = cv2.resize(picture, (480, 270), interpolation=cv2.INTER_AREA)
    window = (0, 0, 1920, 1080)
    return Streams(
        context=Frame(header=header(seq), pixels=small, window=window),
        roi=Frame(header=header(seq), pixels=picture, window=window),
    )


def test_the_shipped_network_is_surer_where_the_object_is_than_where_it_is_not():
    scene = SoccerScene(size_px=(1920, 1080), rate_hz=25, seed=71_000)
    first, later = scene.truth(0), scene.truth(5)
    begun, frame = drawn(scene, 0), drawn(scene, 5)
    here, elsewhere = [], []
    empty = next(  # a place of the lawn without anybody
        place
        for place in (np.array([x, y, x + 40, y + 80], np.float32) for x in range(100, 1800, 100)
                      for y in (900, 800, 700, 600))
        if not iou((place + np.array([-200, -200, 200, 200], np.float32))[None], later.boxes).any()
    )  # fmt: skip
    for row, own in enumerate(first.ids):
        after = np.flatnonzero(later.ids == own)
        if first.visibility[row] < 0.8 or not len(after):
            continue
        tracker = Template()
        tracker.start(begun, first.boxes[row])
        here.append(tracker.follow(frame, later.boxes[after[0]])[1])
        elsewhere.append(tracker.follow(frame, empty)[1])
    scene.close()

    assert len(here) > 5
    assert np.mean(here) > np.mean(elsewhere) + 0.4


def test_another_instance_goes_on_with_the_memory():
    world, first, second = World(seed=3), Template(), Template()
    first.start(Streams(**world.frames(0)), world.box(0))

    assert second.resume(tuple(part.copy() for part in first.memory()))

    streams = Streams(**world.frames(1))
    box, score = first.follow(streams, world.box(0))
    again, same = second.follow(streams, world.box(0))
    np.testing.assert_array_equal(again, box)
    assert same == score


def test_the_memory_of_another_method_is_refused():
    assert not Template().resume((np.zeros((1, 3, 128, 128), np.float32),))


def test_the_operator_answers_with_a_box_in_every_frame_from_the_given_one_on():
    world = World(seed=3)
    values = {"init_box": tuple(world.box(0).tolist())}

    percepts = drive(TemplateTracker, [world.frames(seq) for seq in range(5)], values)

    assert [len(p.boxes) for p in percepts] == [1] * 5


def test_weights_that_are_not_there_are_an_error_that_names_them(tmp_path: Path):
    with pytest.raises(WeightsError, match="expected an ONNX file"):
        TemplateTracker.advise(TemplateTrackerSettings(weights=str(tmp_path / "no.onnx")), {})


def test_weights_of_another_network_are_refused():
    other = SHIPPED.parent.parent / "policy" / "policy.onnx"

    with pytest.raises(WeightsError, match="expected inputs"):
        Template(other)


def test_the_network_is_none_of_the_other_tracker():
    with pytest.raises(WeightsError, match="expected an input"):
        VitTrack(SHIPPED, threads=1)


def test_no_threads_are_refused():
    with pytest.raises(SettingsError, match="threads: expected 1 to 64, got 0"):
        TemplateTrackerSettings(threads=0)
