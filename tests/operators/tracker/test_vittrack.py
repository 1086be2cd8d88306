"""The network tracker agrees with OpenCV's, with the same weights on the same footage."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from operators.tracker import VitTracker, VitTrackerSettings
from operators.tracker.look import Streams
from operators.tracker.vittrack import VitTrack, decode
from pipeline import Frame, WeightsError
from pipeline.boxes import iou
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import World
from tests.shared_data import Footage

NOTHING = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))


def test_the_box_is_decoded_from_the_maps_at_the_best_cell():
    confidence = np.zeros((1, 1, 16, 16), np.float32)
    confidence[0, 0, 4, 8] = 0.9
    sides = np.full((1, 2, 16, 16), 0.25, np.float32)
    offsets = np.full((1, 2, 16, 16), 0.5, np.float32)

    box, score = decode(confidence, sides, offsets, np.ones((16, 16), np.float32))

    assert score == pytest.approx(0.9)
    np.testing.assert_allclose(box * 16, [6.5, 2.5, 10.5, 6.5])


def opencv(weights: str) -> cv2.TrackerVit:
    """Return OpenCV's tracker with deviations that make its scale 1 / deviation.

    It computes 1.0 / Scalar, which in OpenCV is the inverse of a quaternion and not of each value:
    the usual deviations give other scales, two of them negative. The deviations set here are the
    quaternion whose inverse is the wanted scale.
    """
    scale = 1 / np.array([0.229, 0.224, 0.225])
    parameters = cv2.TrackerVit_Params()
    parameters.net = weights
    parameters.stdvalue = (*(scale * [1, -1, -1] / (scale @ scale)).tolist(), 0.0)
    return cv2.TrackerVit_create(parameters)


@pytest.mark.footage
def test_boxes_and_scores_agree_with_opencvs(footage: Footage):
    weights = footage.weights("vittrack")
    folder = footage.data("soccernet/SNMOT-116a/img1")
    left, top, width, height = 136, 520, 51, 135  # a player in the first frame
    theirs, ours = opencv(str(weights)), VitTrack(weights, threads=1)
    box = np.array([left, top, left + width, top + height], np.float32)
    agreement, scores = [], []

    for k in range(1, 16):
        whole = cv2.cvtColor(cv2.imread(str(folder / f"{k:06d}.jpg")), cv2.COLOR_BGR2RGB)
        frame = Frame(header=header(k), pixels=whole, window=(0, 0, 1920, 1080))
        streams = Streams(context=NOTHING, roi=frame)
        if k == 1:
            theirs.init(whole, (left, top, width, height))
            ours.start(streams, box)
            continue
        _, (x, y, w, h) = theirs.update(whole)
        box, score = ours.follow(streams, box)
        agreement.append(iou(np.array([[x, y, x + w, y + h]], np.float32), box[None])[0, 0])
        scores.append(abs(score - theirs.getTrackingScore()))

    assert np.mean(agreement) > 0.9  # OpenCV rounds every box down to whole pixels
    assert min(agreement) > 0.85
    assert np.mean(scores) < 0.05


@pytest.fixture
def bare_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def test_weights_that_were_not_pulled_are_an_error_with_the_command_that_gets_them(bare_home):
    with pytest.raises(WeightsError, match="run `fovea weights pull vittrack`"):
        drive(VitTracker, [])
    with pytest.raises(WeightsError, match="run `fovea weights pull vittrack`"):
        VitTracker.advise(VitTrackerSettings(), {})


def test_a_file_that_is_not_there_is_named_with_the_command_that_gets_one(bare_home):
    with pytest.raises(WeightsError, match=r"got nowhere\.onnx; .*`fovea weights pull vittrack`"):
        drive(VitTracker, [], {"weights": "nowhere.onnx"})


@pytest.mark.footage
def test_a_successor_continues_with_the_template_of_its_predecessor(footage: Footage):
    weights = footage.weights("vittrack")
    world = World(seed=11)
    first, second = (VitTrack(weights, threads=1) for _ in range(2))
    first.start(Streams(**world.frames(0)), world.box(0))

    assert second.resume(first.memory())
    ours, theirs = (s.follow(Streams(**world.frames(1)), world.box(0)) for s in (second, first))

    np.testing.assert_array_equal(ours[0], theirs[0])
    assert not second.resume(())


@pytest.mark.footage
def test_the_operator_follows_with_the_network(footage: Footage):
    weights = footage.weights("vittrack")
    world = World(seed=11)
    values = {
        "weights": str(weights),
        "init_box": tuple(world.box(0).tolist()),
    }

    percepts = drive(VitTracker, [world.frames(k) for k in range(15)], values)

    assert min(float(iou(p.boxes, world.box(k)[None])[0, 0]) for k, p in enumerate(percepts)) > 0.5
