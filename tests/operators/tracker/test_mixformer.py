"""The network tracker of the paper, with networks whose outputs are known."""

from pathlib import Path

import numpy as np
import pytest

from operators.tracker import (
    CorrelationSettings,
    MixFormerTracker,
    MixFormerTrackerSettings,
    mixformer,
)
from operators.tracker.look import Streams
from operators.tracker.mixformer import MixFormer
from pipeline import Frame
from pipeline.boxes import centres
from pipeline.errors import SettingsError, WeightsError
from pipeline.settings import build
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import FIELD, World

pytest.importorskip("onnx", reason="needs the train extra")
from onnx import TensorProto, helper, numpy_helper, save_model

VOTES = np.array([[0.5, 0.5, 0.2, 0.2], [0.6, 0.5, 0.2, 0.4]], np.float32)  # cx, cy, w, h


def network(path: Path, *, names: tuple[str, ...] = mixformer.INPUTS, side: int = 32) -> Path:
    """Write a network that returns `VOTES`, and the mean of the second template as score."""
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 3, px, px))
        for name, px in zip(names, (side, side, 2 * side), strict=True)
    ]
    outputs = [
        helper.make_tensor_value_info("pred_boxes", TensorProto.FLOAT, VOTES.shape),
        helper.make_tensor_value_info("pred_scores", TensorProto.FLOAT, (1,)),
    ]
    means = [f"{name}_mean" for name in names]
    nodes = [
        helper.make_node("ReduceMean", [name], [mean], keepdims=0)
        for name, mean in zip(names, means, strict=True)
    ]
    nodes += [  # every input must be used, or ONNX Runtime removes it
        helper.make_node("Sum", means, ["sum"]),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "votes"], ["pred_boxes"]),
        helper.make_node("Reshape", [means[1], "one"], ["pred_scores"]),
    ]
    constants = {"zero": np.zeros((), np.float32), "votes": VOTES, "one": np.array([1])}
    weights = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    graph = helper.make_graph(nodes, "votes", inputs, outputs, weights)
    opsets = [helper.make_opsetid("", 17)]
    save_model(helper.make_model(graph, opset_imports=opsets, ir_version=9), path)
    return path


def grey(level: int) -> Streams:
    pixels = np.full((1080, 1920, 3), level, np.uint8)
    frame = Frame(header=header(), pixels=pixels, window=FIELD)
    return Streams(context=frame, roi=frame)


def test_the_mean_of_the_boxes_is_returned_in_sensor_pixels(tmp_path: Path) -> None:
    subject = MixFormer(network(tmp_path / "m.onnx"))
    box = np.array([380, 280, 420, 320], np.float32)
    subject.start(grey(128), box)

    found, score = subject.follow(grey(128), box)

    side = 4.5 * 40
    assert np.allclose(centres(found), [400 + 0.05 * side, 300])
    assert np.allclose(found[2:] - found[:2], [0.2 * side, 0.3 * side])
    assert 0 < score < 1


def test_scores_outside_a_probability_show_that_all_are_logits(tmp_path: Path) -> None:
    subject = MixFormer(network(tmp_path / "m.onnx"))
    box = np.array([380, 280, 420, 320], np.float32)
    scores = []

    for level in (40, 130, 140, 250):  # means of about -1.3, .2, .4 and 2.4
        subject.start(grey(level), box)
        scores.append(subject.follow(grey(128), box)[1])

    assert scores == sorted(scores)
    assert 0 < scores[0] < 0.3 < 0.5 < scores[1]


def test_the_look_with_the_best_score_becomes_the_second_template_after_some_frames(
    tmp_path: Path,
) -> None:
    subject = MixFormer(network(tmp_path / "m.onnx"), renew_every=3)
    box = np.array([380, 280, 420, 320], np.float32)
    subject.start(grey(150), box)

    scores = [subject.follow(grey(140), box)[1] for _ in range(4)]

    assert scores[0] == scores[1] == scores[2] > mixformer.RENEW_SCORE
    assert scores[3] < scores[0]  # a darker template


@pytest.mark.parametrize("frames", [0, 2])
def test_a_successor_continues_with_both_templates_and_their_age(
    tmp_path: Path, frames: int
) -> None:
    weights, box = network(tmp_path / "m.onnx"), np.array([380, 280, 420, 320], np.float32)
    first, second = (MixFormer(weights, renew_every=3) for _ in range(2))
    first.start(grey(150), box)
    for _ in range(frames):
        first.follow(grey(140), box)

    assert second.resume(first.memory())
    scores = [[s.follow(grey(140), box)[1] for _ in range(4)] for s in (first, second)]

    assert scores[0] == scores[1]


def test_memory_of_a_network_of_another_size_is_not_taken_over(tmp_path: Path) -> None:
    small, large = (MixFormer(network(tmp_path / f"{s}.onnx", side=s)) for s in (32, 64))
    small.start(grey(150), np.array([380, 280, 420, 320], np.float32))

    assert not large.resume(small.memory())


def test_the_operator_follows_with_the_network(tmp_path: Path) -> None:
    world, weights = World(seed=3), network(tmp_path / "m.onnx")
    settings = {"weights": str(weights), "init_box": tuple(world.box(0).tolist())}

    percepts = drive(MixFormerTracker, [world.frames(k) for k in range(2)], settings)

    side = 4.5 * 40
    assert np.allclose(
        percepts[1].boxes[0, 2:] - percepts[1].boxes[0, :2], [0.2 * side, 0.3 * side]
    )


def test_networks_of_another_kind_are_refused(tmp_path: Path) -> None:
    other = network(tmp_path / "other.onnx", names=("a", "b", "c"))

    with pytest.raises(WeightsError, match=r"expected img_t, img_ot, img_search -> .* got a, b, c"):
        drive(MixFormerTracker, [], {"weights": str(other)})


@pytest.mark.parametrize("weights", ["", "nowhere.onnx"])
def test_missing_weights_are_refused_when_the_graph_is_checked_and_when_it_opens(
    weights: str,
) -> None:
    with pytest.raises(WeightsError, match="expected MixFormerV2 as an ONNX file, got n"):
        drive(MixFormerTracker, [], {"weights": weights})
    with pytest.raises(WeightsError, match="expected MixFormerV2 as an ONNX file, got n"):
        MixFormerTracker.advise(MixFormerTrackerSettings(weights=weights), {})


def test_the_settings_of_one_tracker_are_refused_by_another() -> None:
    with pytest.raises(SettingsError, match=r"tracker\.weights: required"):
        build(MixFormerTrackerSettings, {}, "tracker")
    with pytest.raises(SettingsError, match=r"tracker\.renew_every: no such setting"):
        build(CorrelationSettings, {"renew_every": 4}, "tracker")
