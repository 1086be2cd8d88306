"""Users' own exports: what a file, its side file and the settings say together."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.saliency.detector import Detector
from operators.saliency.saliency import Saliency, SaliencySettings
from pipeline import MessageError, SettingsError, WeightsError
from tests.commands import command
from tests.operators.networks import constant_network, counting_network
from tests.operators.saliency.test_saliency import seen, yolo_output

ULTRALYTICS = {
    "task": "detect",
    "stride": "32",
    "imgsz": "[288, 480]",
    "names": "{0: 'person', 1: 'dog'}",
}
# a picture of 480x270 lies 9 rows below the top of an input of 480x288; the sensor has 1920x1080
AT, BOX = (100, 59, 20, 40), [360, 120, 440, 280]
OPEN: tuple[int | str, int | str] = ("width", "height")


def end2end(*rows: tuple[float, ...], most: int = 300) -> NDArray[np.float32]:
    """(1, most, len(row)): the rows given, then empty ones."""
    output = np.zeros((1, most, len(rows[0])), np.float32)
    output[0, : len(rows)] = rows
    return output


def yolox_output(size_px: tuple[int, int], *rows: tuple[float, ...]) -> NDArray[np.float32]:
    """(1, anchors, len(row)), the first anchors as given."""
    anchors = sum((size_px[0] // s) * (size_px[1] // s) for s in (8, 16, 32))
    return end2end(*rows, most=anchors)


def test_an_export_with_open_sides_runs_at_the_size_it_was_exported_with(tmp_path: Path) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((*AT, 0.1, 0.9)), size_px=OPEN, batch="n", **ULTRALYTICS
    )

    found = seen(weights)

    assert found.boxes.tolist() == [BOX]
    assert found.names[found.labels[0]] == "dog"


def test_the_size_comes_from_settings_before_the_side_file_before_the_export(
    tmp_path: Path,
) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((*AT, 0.1, 0.9)), size_px=OPEN, **ULTRALYTICS
    )

    def size(**settings: object) -> tuple[int, ...]:
        made = Detector(SaliencySettings(weights=weights, **settings))  # type: ignore[arg-type]
        return made._box.tensor.shape[2:]

    assert size() == (288, 480)
    (tmp_path / "n.yaml").write_text("input_px: [640, 384]\n")
    assert size() == (384, 640)
    assert size(input_px=(320, 192)) == (192, 320)


def test_what_needs_no_suppression_is_read(tmp_path: Path) -> None:
    output = end2end((90, 39, 110, 79, 0.9, 1), (300, 99, 310, 109, 0.1, 0))
    weights = constant_network(tmp_path / "n.onnx", output, **ULTRALYTICS)

    found = seen(weights)

    assert found.boxes.tolist() == [BOX]
    assert found.names[found.labels[0]] == "dog"
    assert len(seen(weights, confidence=0.05).scores) == 2
    assert found.features.shape == (1, 0)


def test_turned_boxes_that_need_no_suppression_keep_their_angle(tmp_path: Path) -> None:
    output = end2end((100, 59, 20, 40, 0.9, 1, 0.5))
    weights = constant_network(tmp_path / "n.onnx", output, **(ULTRALYTICS | {"task": "obb"}))

    found = seen(weights)

    assert found.boxes.tolist() == [BOX]
    assert found.angles.tolist() == [0.5]


def test_half_precision_is_read(tmp_path: Path) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((*AT, 0.1, 0.75)), half=True, **ULTRALYTICS
    )

    found = seen(weights)

    assert found.boxes.tolist() == [BOX]
    assert found.boxes.dtype == np.float32
    assert found.scores.tolist() == [0.75]


def test_a_yolox_export_takes_its_names_from_a_side_file(tmp_path: Path) -> None:
    # the first cell of stride 8: its centre moves by 12.5 cells, its sides are 2.5 and 5 cells
    row = (12.5, 6.25, np.log(2.5), np.log(5), 0.9, 0.1, 0.9)
    weights = constant_network(tmp_path / "n.onnx", yolox_output((480, 288), row))
    (tmp_path / "n.yaml").write_text("names: [person, dog]\nconfidence: 0.8\n")

    found = seen(weights)

    assert found.boxes[0] == pytest.approx([360, 120, 440, 280], abs=1e-3)
    assert found.names == ("person", "dog")
    assert found.scores.tolist() == pytest.approx([0.81])
    (tmp_path / "n.yaml").write_text("names: [person, dog]\nconfidence: 0.82\n")
    assert len(seen(weights).scores) == 0


def test_a_decoded_yolox_export_is_asked_for_by_name(tmp_path: Path) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolox_output((480, 288), (100, 50, 20, 40, 0.9, 0.1, 0.9))
    )

    found = seen(weights, format="yolox_decoded")

    assert found.boxes.tolist() == [BOX]
    assert found.names == ("0", "1")


def test_classes_without_names_are_warned_of(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((*AT, 0.9, 0)))

    def told(**settings: object) -> list[str]:
        made = SaliencySettings(weights=weights, **settings)  # type: ignore[arg-type]
        return [line for line in Saliency.advise(made, {}) if line.startswith("warning")]

    assert told() == [
        "warning: nothing names the classes of n.onnx: they are called by their numbers; a list "
        "`names` in n.yaml beside it names them"
    ]
    assert told(names={"0": "person"}) == []
    (tmp_path / "n.yaml").write_text("names: [person, dog]\n")
    assert told() == []


def test_a_class_keeps_its_own_threshold_under_another_name(tmp_path: Path) -> None:
    output = yolo_output((100, 59, 20, 40, 0.4, 0), (300, 59, 20, 40, 0, 0.4))
    weights = constant_network(tmp_path / "n.onnx", output, names="['man', 'woman']")
    (tmp_path / "n.yaml").write_text(
        "names: [man, woman]\nconfidence: 0.3\nclass_confidence: {man: 0.5}\n"
    )
    both = {"man": "person", "woman": "person"}

    assert len(seen(weights, names=both).scores) == 1
    assert len(seen(weights, names=both, class_confidence={"person": 0.35}).scores) == 2


def test_two_classes_of_one_name_are_one(tmp_path: Path) -> None:
    output = yolo_output((100, 59, 20, 40, 0.9, 0, 0), (300, 59, 20, 40, 0, 0, 0.8))
    weights = constant_network(tmp_path / "n.onnx", output, names="['cat', 'dog', 'cat']")

    found = seen(weights)

    assert found.names == ("cat", "dog")
    assert found.labels.tolist() == [0, 0]


def test_names_of_another_number_of_classes_are_refused(tmp_path: Path) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((*AT, 0.9, 0, 0)), names="['person', 'dog']"
    )

    with pytest.raises(WeightsError, match=r"n\.onnx: metadata names: expected 3 names, .* got 2"):
        seen(weights)
    (tmp_path / "n.yaml").write_text("# mine\nnames: [person, dog, cat, cup]\n")
    with pytest.raises(
        WeightsError, match=r"n\.yaml:2: detector\.names: expected 3 names, .* got 4"
    ):
        seen(weights)


def test_suppressed_output_needs_names_and_has_no_class_beyond_them(tmp_path: Path) -> None:
    output = end2end((90, 39, 110, 79, 0.9, 2))
    weights = constant_network(tmp_path / "n.onnx", output)

    with pytest.raises(WeightsError, match=r"expected names .* in its metadata or in n\.yaml"):
        seen(weights)
    (tmp_path / "n.yaml").write_text("names: [person, dog]\n")
    with pytest.raises(MessageError, match=r"saliency: expected classes 0 to 1, .* got 2"):
        seen(weights)


def test_two_inputs_are_refused(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((*AT, 0.9)), more_inputs=("sizes",))

    with pytest.raises(WeightsError, match=r"n\.onnx: expected one input, got images, sizes"):
        seen(weights)


def test_a_batch_of_several_is_refused(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((*AT, 0.9)), batch=8)

    with pytest.raises(WeightsError, match=r"expected an input \(1, 3, height, width\), got \[8"):
        seen(weights)


def test_an_input_of_whole_numbers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        WeightsError, match=r"expected an input of tensor\(float\) .* tensor\(uint8\)"
    ):
        seen(counting_network(tmp_path / "n.onnx"))


@pytest.mark.parametrize(
    ("size_px", "settings", "side", "message"),
    [
        (OPEN, {}, "", "input_px: n.onnx leaves the size of its input open: .* here or in n.yaml"),
        (OPEN, {"input_px": (100, 64)}, "", r"input_px: expected multiples of 32 for n.onnx, got"),
        (OPEN, {"input_px": (9999, 64)}, "", "input_px: expected a width and a height of 1 to"),
        (OPEN, {}, "input_px: [100, 64]", r"n\.yaml:1: detector\.input_px: expected multiples of"),
        ((480, 288), {"input_px": (640, 384)}, "", "input_px: the input of n.onnx is 480x288, exp"),
        ((480, 288), {}, "input_px: [640, 384]", r"n\.yaml:1: detector\.input_px: the input of n"),
        ((480, 288), {"format": "yolox"}, "", r"n\.onnx: expected an output of format yolox, got"),
        ((480, 288), {}, "format: end2end", r"n\.onnx: expected an output of format end2end, got"),
        ((480, 288), {}, "names: [a, b]", r"n\.yaml:1: detector\.names: expected 1 names"),
    ],
)
def test_what_contradicts_the_network_is_refused(
    tmp_path: Path,
    size_px: tuple[int | str, int | str],
    settings: dict[str, object],
    side: str,
    message: str,
) -> None:
    weights = constant_network(tmp_path / "n.onnx", yolo_output((*AT, 0.9)), size_px=size_px)
    if side:
        (tmp_path / "n.yaml").write_text(side)

    with pytest.raises((WeightsError, SettingsError), match=message):
        seen(weights, **settings)


def test_a_refused_size_of_a_graph_comes_with_the_change_that_helps(tmp_path: Path) -> None:
    names = "['player', 'goalkeeper', 'referee', 'ball']"
    output = yolo_output((*AT, 0.9, 0, 0, 0))
    weights = constant_network(tmp_path / "n.onnx", output, size_px=(640, 384), names=names)
    graph = ("check", "tracking", "--set", f"saliency.weights={weights}")
    usual = ("--set", "saliency.input_px=[736,416]")

    refused = command(*graph, *usual)
    told = re.search(r"--set NODE\.(input_px=\S+), got", refused.stderr)

    assert told, refused.stderr
    helped = command(*graph, *usual, "--set", f"saliency.{told[1]}")
    assert (refused.returncode, helped.returncode) == (2, 0), helped.stderr


def test_a_huge_input_is_refused_before_it_is_made(tmp_path: Path) -> None:
    weights = constant_network(
        tmp_path / "n.onnx", yolo_output((*AT, 0.9)), size_px=(1 << 20, 1 << 20)
    )

    with pytest.raises(WeightsError, match="expected an input of up to 8192 pixels"):
        seen(weights)
