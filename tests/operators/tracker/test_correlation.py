"""The arithmetic of the tracker without weights."""

import numpy as np
import pytest

from operators.tracker.correlation import Correlation, refined, vertex
from operators.tracker.look import Streams
from pipeline import Frame
from pipeline.testing import header
from tests.operators.tracker.made_up import World

FLAT = Frame(header=header(), pixels=np.full((270, 480, 3), 8, np.uint8), window=(0, 0, 1920, 1080))


def test_the_peak_of_a_parabola_is_found_between_the_cells():
    values = [-((x - 0.3) ** 2) for x in (-1, 0, 1)]

    assert vertex(*values) == pytest.approx(0.3)


def test_a_peak_at_the_rim_is_left_where_it_is():
    assert refined(np.eye(3, dtype=np.float32), 0, 0).tolist() == [0, 0]


def test_a_still_object_is_found_where_it_is():
    world = World(seed=3)
    streams, box = Streams(**world.frames(0)), world.box(0)
    subject = Correlation()

    subject.start(streams, box)
    found, score = subject.follow(streams, box)

    np.testing.assert_allclose(found, box, atol=1.0)
    assert score > 0.9


def test_a_picture_without_structure_is_not_the_object():
    world = World(seed=3)
    subject = Correlation()
    subject.start(Streams(**world.frames(0)), world.box(0))

    found, score = subject.follow(Streams(context=FLAT, roi=FLAT), world.box(0))

    assert score < subject.patience_score
    assert np.isfinite(found).all()


def test_a_template_taken_beside_the_object_is_aligned_with_its_predicted_box():
    world = World(seed=3)
    streams, true = Streams(**world.frames(0)), world.box(0)
    box = true + np.float32(10)
    subject = Correlation()

    subject.start(streams, box)
    before, _ = subject.follow(streams, box)
    for _ in range(20):
        box = subject.aligned(box, true)
        box, _ = subject.follow(streams, box)

    assert np.abs(before - true).max() > 8
    np.testing.assert_allclose(box, true, atol=1.5)


def test_memory_of_another_method_is_not_taken_over():
    assert not Correlation().resume((np.zeros((1, 3, 128, 128), np.float32),))
