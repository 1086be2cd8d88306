"""Networks whose output is no box or no score: it is left out, and somebody hears of it."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.saliency import Saliency
from operators.saliency.decode import decode_end2end, decode_yolo, decode_yolox, usable
from operators.saliency.detector import Detector
from operators.saliency.saliency import SaliencySettings
from pipeline.contract import HEADLINE
from tests.operators.networks import constant_network
from tests.operators.saliency.test_exports import end2end, yolox_output
from tests.operators.saliency.test_saliency import context, seen, yolo_output

GOOD, BOX = (100, 59, 20, 40, 0.9), [360, 120, 440, 280]
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "row",
    [
        (300, NAN, 20, 40, 0.9),
        (INF, 59, INF, 40, 0.9),
        (300, 59, -20, 40, 0.9),
        (300, 59, 20, 0, 0.9),
        (300, 59, 1e30, 1e30, 0.9),
        (3e38, 59, 3e38, 40, 0.9),
        (300, 59, 20, 40, NAN),
        (300, 59, 20, 40, INF),
        (300, 59, 20, 40, 55),
    ],
)
def test_what_is_no_box_or_no_score_is_left_out(tmp_path: Path, row: tuple[float, ...]) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output(row, GOOD))

    found = seen(weights)

    assert found.boxes.tolist() == [BOX]
    assert found.scores.tolist() == [np.float32(0.9)]


@pytest.mark.parametrize("value", [NAN, INF])
@pytest.mark.parametrize(
    ("output", "settings"),
    [
        (yolo_output(GOOD), {}),
        (yolo_output((*GOOD, 0.1)), {"format": "obb"}),
        (yolox_output((480, 288), (*GOOD, 0.9)), {"format": "yolox"}),
        (yolox_output((480, 288), (*GOOD, 0.9)), {"format": "yolox_decoded"}),
    ],
)
def test_a_network_that_gives_no_numbers_finds_nothing_and_is_reported(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    output: NDArray[np.float32],
    settings: dict[str, str],
    value: float,
) -> None:
    weights = constant_network(tmp_path / "n.onnx", np.full_like(output, value))
    detector = Detector(SaliencySettings(weights=weights, **settings))  # type: ignore[arg-type]

    found = [detector.look(context().pixels)[0] for _ in range(2)]

    assert [len(each.scores) for each in found] == [0, 0]
    assert caplog.text.count("n.onnx: expected finite boxes with sides above 0 and scores") == 1
    assert detector.summary()["unusable_boxes"] == detector.unusable > 100


def test_rows_without_a_number_of_a_network_that_suppresses_are_reported(tmp_path: Path) -> None:
    output = end2end((90, 39, 110, 79, 0.9, 0), (NAN,) * 6, (110, 39, 90, 79, 0.8, 0))
    weights = constant_network(tmp_path / "n.onnx", output, names="['person']")
    detector = Detector(SaliencySettings(weights=weights))

    found, _, _ = detector.look(context().pixels)

    assert found.boxes.tolist() == [[90, 39, 110, 79]]
    told = "2 boxes of n.onnx were unusable, as the log says"
    assert detector.summary()[HEADLINE] == told


def test_a_sound_network_is_not_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    # half of the box lies beyond the picture
    weights = constant_network(tmp_path / "n.onnx", yolo_output((0, 59, 20, 40, 0.9), GOOD))
    detector = Detector(SaliencySettings(weights=weights))

    found, _, _ = detector.look(context().pixels)

    assert found.boxes[:, 0].tolist() == [-10, 90]
    assert detector.summary() == detector.network.where()
    assert not caplog.records


def test_a_score_that_rounding_put_above_one_is_one(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((*GOOD[:4], 1.004)))

    assert seen(weights).scores.tolist() == [1]


def test_the_operator_says_it_in_its_summary(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((300, NAN, 20, 40, 0.9)))
    operator = Saliency(SaliencySettings(weights=weights))
    operator.open()

    operator.on_frame(context())

    assert operator.summary()["unusable_boxes"] == 1


@pytest.mark.parametrize("seed", range(3))
def test_every_candidate_of_a_sound_output_is_usable(seed: int) -> None:
    random = np.random.default_rng(seed)
    output = random.uniform(0.1, 1, (6, 50)).astype(np.float32)

    assert usable(decode_yolo(output, np.full(2, 0.3, np.float32))).all()
    assert usable(decode_yolox(output.T, np.full(1, 0.3, np.float32), None)).all()


def test_a_turned_box_without_an_angle_is_unusable() -> None:
    output = np.array([[100, 59, 20, 40, 0.9, 0, NAN], [100, 59, 20, 40, 0.8, 0, 0.5]], np.float32)

    assert usable(decode_end2end(output, np.array([0.3], np.float32))).tolist() == [False, True]
