"""The operator with tiny networks of known output, and with YOLOX-nano if it is available."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from operators.saliency import Saliency
from pipeline import Detections, Frame, MessageError, SettingsError, WeightsError
from pipeline.testing import drive, header, picture
from tests.operators.networks import constant_network
from tests.shared_data import Footage


def yolo_output(*rows: tuple[float, ...], anchors: int = 64) -> NDArray[np.float32]:
    """Return an output (1, len(row), anchors): one column for each row, the others zero."""
    output = np.zeros((1, len(rows[0]), anchors), np.float32)
    output[0, :, : len(rows)] = np.array(rows, np.float32).T
    return output


def context(seq: int = 0) -> Frame:
    """Return a quarter-size picture of a full-HD sensor."""
    return Frame(header=header(seq), pixels=picture(270, 480, seed=1), window=(0, 0, 1920, 1080))


def seen(weights: str, frame: Frame | None = None, **settings: object) -> Detections:
    """Return the operator's output for one frame."""
    (answer,) = drive(Saliency, [frame or context()], {"weights": weights, **settings})
    assert isinstance(answer, Detections)
    return answer


def test_a_box_of_the_input_is_returned_in_sensor_pixels(tmp_path: Path) -> None:
    # 9 rows of padding above the 270 rows of the picture
    output = yolo_output((100, 59, 20, 40, 0.9, 0.1))
    weights = constant_network(tmp_path / "n.onnx", output, names="{0: 'player', 1: 'ball'}")

    found = seen(weights)

    assert found.boxes.tolist() == [[360, 120, 440, 280]]
    assert found.names[found.labels[0]] == "player"
    assert found.scores[0] == pytest.approx(0.9)
    assert found.features.shape == (1, 0)


def test_the_corner_of_the_window_is_added_to_boxes(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((100, 59, 20, 40, 0.9)))
    frame = Frame(header=header(), pixels=picture(270, 480, seed=1), window=(1000, 500, 1480, 770))

    found = seen(weights, frame)

    assert found.boxes.tolist() == [[1090, 530, 1110, 570]]


def test_boxes_are_cut_at_the_window(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((0, 9, 40, 40, 0.9)))

    assert seen(weights).boxes.tolist() == [[0, 0, 80, 80]]


def test_the_weaker_of_two_boxes_in_one_place_is_suppressed(tmp_path: Path) -> None:
    output = yolo_output((100, 99, 20, 40, 0.6, 0), (101, 99, 20, 40, 0, 0.8))
    weights = constant_network(tmp_path / "n.onnx", output)

    assert seen(weights).scores.tolist() == pytest.approx([0.8])
    assert len(seen(weights, class_agnostic=False).scores) == 2


def test_thresholds_in_settings_override_those_in_the_metadata(tmp_path: Path) -> None:
    output = yolo_output((100, 99, 20, 40, 0.45, 0), (300, 99, 9, 9, 0, 0.35))
    weights = constant_network(
        tmp_path / "n.onnx",
        output,
        names="['player', 'ball']",
        confidence="{'player': 0.5, 'ball': 0.3}",
    )

    assert seen(weights).labels.tolist() == [1]
    assert seen(weights, class_confidence={"ball": 0.4}).labels.tolist() == []
    assert seen(weights, confidence=0.4).labels.tolist() == [0]


def test_classes_are_renamed_and_others_left_out(tmp_path: Path) -> None:
    output = yolo_output((100, 99, 20, 40, 0.9, 0, 0), (300, 99, 9, 9, 0, 0.9, 0))
    weights = constant_network(tmp_path / "n.onnx", output, names="['car', 'person', 'dog']")

    found = seen(weights, names={"person": "player"})

    assert found.names == ("player",)
    assert found.labels.tolist() == [0]
    assert found.boxes[0, 0] == pytest.approx(4 * 295.5)


def test_features_are_aligned_from_the_stride_8_map(tmp_path: Path) -> None:
    ramp = np.broadcast_to(np.arange(60, dtype=np.float32), (1, 2, 36, 60)).copy()
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((100, 99, 16, 16, 0.9)), features=ramp
    )

    assert seen(weights).features == pytest.approx(np.full((1, 2), 100 / 8 - 0.5))


def test_turned_boxes_keep_their_angle_and_do_not_suppress_boxes_across_them(
    tmp_path: Path,
) -> None:
    # two long boxes crossing at a right angle share little; a third lies on the first
    output = yolo_output(
        (200, 99, 100, 10, 0.9, 0.0), (200, 99, 100, 10, 0.8, 1.57), (200, 99, 100, 10, 0.7, 0.02)
    )
    weights = constant_network(tmp_path / "n.onnx", output, task="obb")

    found = seen(weights)

    assert found.angles == pytest.approx([0, 1.57])
    assert found.boxes.tolist() == [[600, 340, 1000, 380]] * 2


def test_an_empty_picture_gives_an_empty_answer(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((100, 99, 16, 16, 0.9)))
    frame = Frame(header=header(7), pixels=np.zeros((0, 0, 3), np.uint8))

    found = seen(weights, frame)

    assert found.boxes.shape == (0, 4)
    assert found.header.seq == 7


def test_a_mosaic_is_refused_with_a_hint(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((100, 99, 16, 16, 0.9)))
    frame = Frame(
        header=header(),
        pixels=picture(270, 480, seed=1)[..., 0],
        pixel_format="bayer_rggb8",
        window=(0, 0, 1920, 1080),
    )

    with pytest.raises(MessageError, match=r"bayer_rggb8 uint8; put operators\.downsample before"):
        seen(weights, frame)


def test_missing_weights_are_named(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"nowhere\.onnx: no such weights"):
        seen(str(tmp_path / "nowhere.onnx"))


def test_a_file_that_is_no_network_is_named(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("not a network")

    with pytest.raises(WeightsError, match=r"text\.onnx: not a network"):
        seen(str(tmp_path / "text.onnx"))


def test_an_output_of_unknown_shape_is_refused(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", np.zeros((1, 300, 9), np.float32))

    with pytest.raises(WeightsError, match=r"n\.onnx: expected an output .* got \(1, 300, 9\)"):
        seen(weights)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"confidence": 1.5}, "confidence: must be within 0..1, got 1.5"),
        ({"class_confidence": {"ball": -1.0}}, "class_confidence.ball: must be within"),
        ({"max_objects": 0}, "max_objects: must be at least 1, got 0"),
        ({"class_confidence": {"bal": 0.5}}, "expected names among 0, got bal"),
        ({"names": {"person": "player"}}, "names.person: expected a class of the network"),
    ],
)
def test_a_wrong_setting_is_named(
    tmp_path: Path, settings: dict[str, object], message: str
) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((100, 99, 16, 16, 0.9)))

    with pytest.raises(SettingsError, match=message):
        seen(weights, **settings)


@pytest.mark.footage
def test_yolox_nano_finds_players_in_real_footage(footage: Footage) -> None:
    clip = footage.data("soccernet/SNMOT-116a/img1")
    full = cv2.imread(str(clip / "000100.jpg"), cv2.IMREAD_COLOR_RGB)
    small = cv2.resize(full, (480, 270), interpolation=cv2.INTER_AREA)
    frame = Frame(header=header(), pixels=np.asarray(small), window=(0, 0, 1920, 1080))

    found = seen(str(footage.weights("yolox_nano")), frame, names={"0": "player", "32": "ball"})

    assert len(found.scores) >= 8
    assert set(found.labels.tolist()) == {0}
    assert np.all(np.diff(found.boxes[:, [1, 3]]) > 40)


def test_a_name_that_no_manifest_knows_is_refused() -> None:
    with pytest.raises(WeightsError, match="nonsense"):
        seen("nonsense")
