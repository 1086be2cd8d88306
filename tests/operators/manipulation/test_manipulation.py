"""The live consumer: a network of the contract acts, others are refused, chunks survive a swap."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="needs the train extra")

from drivers.robot import Joints  # noqa: E402
from operators.manipulation import ActionChunking, ActionChunkingSettings  # noqa: E402
from operators.manipulation.network import ActNetwork  # noqa: E402
from pipeline import Frame, Geometry, Header, MessageError, SettingsError, WeightsError  # noqa: E402

CHUNK, SIZE = 5, (16, 8)


def network(path: Path, *, joints: int = 2, name: str = "picture", **facts: str) -> Path:
    """Write a network that tells the joints, plus the mean of the picture over 255, in each row."""
    helper, kind = onnx.helper, onnx.TensorProto
    nodes = [
        helper.make_node("Cast", [name], ["numbers"], to=kind.FLOAT),
        helper.make_node("ReduceMean", ["numbers"], ["mean"], keepdims=0),
        helper.make_node("Div", ["mean", "white"], ["bright"]),
        helper.make_node("Add", ["joints", "bright"], ["row"]),
        helper.make_node("Unsqueeze", ["row", "one"], ["rows"]),
        helper.make_node("Tile", ["rows", "repeats"], ["targets"]),
    ]
    graph = helper.make_graph(
        nodes,
        "act",
        [
            helper.make_tensor_value_info(name, kind.UINT8, [1, SIZE[1], SIZE[0], 3]),
            helper.make_tensor_value_info("joints", kind.FLOAT, [1, joints]),
        ],
        [helper.make_tensor_value_info("targets", kind.FLOAT, [1, CHUNK, joints])],
        [
            helper.make_tensor("white", kind.FLOAT, [], [255.0]),
            helper.make_tensor("one", kind.INT64, [1], [1]),
            helper.make_tensor("repeats", kind.INT64, [3], [1, CHUNK, 1]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, facts)
    onnx.save(model, path)
    return path


def exposure(seq: int, bright: int, joints: int = 2) -> dict[str, Any]:
    geometry = Geometry(width_px=64, height_px=32)
    header = Header(stream="s", seq=seq, stamp_ns=seq, geometry=geometry)
    whole = np.full((4, 8, 3), bright, np.uint8)
    numbers = np.zeros(joints, np.float32)
    return {
        "context": Frame(header=header, pixels=whole, window=(0, 0, 64, 32)),
        "roi": Frame(header=header, pixels=np.zeros((0, 0, 3), np.uint8)),
        "joints": Joints(header=header, positions=numbers, velocities=numbers),
    }


def consumer(weights: Path, **settings: Any) -> ActionChunking:
    found = ActionChunking(ActionChunkingSettings(weights=str(weights), **settings))
    found.open()
    return found


def test_an_exposure_is_answered_by_the_targets_of_the_next_steps(tmp_path: Path) -> None:
    subject = consumer(network(tmp_path / "act.onnx"), ahead=3)

    answer = subject.on_context_roi_joints(**exposure(0, 51))

    np.testing.assert_allclose(answer.action, [0.2] * 6, atol=1e-6)
    assert answer.header.seq == 0
    assert len(answer.boxes) == 0


def test_the_roi_lies_over_the_context(tmp_path: Path) -> None:
    subject = consumer(network(tmp_path / "act.onnx"), ahead=1)
    given = exposure(0, 0)
    white = np.full((4, 4, 3), 255, np.uint8)
    roi = Frame(header=given["roi"].header, pixels=white, window=(0, 0, 32, 16))

    answer = subject.on_context_roi_joints(**(given | {"roi": roi}))

    np.testing.assert_allclose(answer.action, 0.25, atol=1e-6)


@pytest.mark.parametrize(("levels", "second"), [(6.0, 0.5), (0.0, 0.25)])
def test_what_the_roi_showed_stays_in_the_picture_if_so_set(
    tmp_path: Path, levels: float, second: float
) -> None:
    weights = network(tmp_path / "act.onnx")
    subject = consumer(weights, ahead=1, decay=0.0, change_levels=levels)
    white = np.full((4, 4, 3), 255, np.uint8)
    for seq, window in enumerate([(0, 0, 32, 16), (32, 16, 64, 32)]):
        given = exposure(seq, 0)
        roi = Frame(header=given["roi"].header, pixels=white, window=window)
        answer = subject.on_context_roi_joints(**(given | {"roi": roi}))

    np.testing.assert_allclose(answer.action, (0.25 + second) / 2, atol=1e-6)


def test_a_successor_goes_on_with_the_chunks_and_another_stream_without(tmp_path: Path) -> None:
    weights = network(tmp_path / "act.onnx")
    first, second = consumer(weights), consumer(weights)
    first.on_context_roi_joints(**exposure(0, 255))

    second.restore(first.state())
    kept = second.on_context_roi_joints(**exposure(1, 0)).action[0]
    first.on_stream(exposure(2, 0)["context"].header)
    forgot = first.on_context_roi_joints(**exposure(2, 0)).action[0]

    assert kept > 0.5
    assert forgot == 0


def test_a_network_may_look_at_a_part_of_the_field(tmp_path: Path) -> None:
    subject = ActNetwork(network(tmp_path / "act.onnx", workplace="0.25 0 0.75 1"))

    assert subject.workplace == (0.25, 0, 0.75, 1)
    assert subject.picture_px == SIZE


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ({"name": "image"}, "expected inputs picture"),
        ({"workplace": "0 0 1"}, "workplace: expected four shares"),
        ({"workplace": "0 0 2 1"}, "workplace: expected four shares"),
        ({"workplace": "a b c d"}, "workplace: expected four shares"),
    ],
)
def test_another_network_is_refused(tmp_path: Path, made: dict[str, str], words: str) -> None:
    with pytest.raises(WeightsError, match=words):
        consumer(network(tmp_path / "act.onnx", **made))  # type: ignore[arg-type]


def test_other_joints_and_pixels_are_refused(tmp_path: Path) -> None:
    subject = consumer(network(tmp_path / "act.onnx"))
    given = exposure(0, 9)
    raw = Frame(
        header=given["roi"].header,
        pixels=np.zeros((4, 4), np.uint8),
        pixel_format="bayer_rggb8",
        window=(0, 0, 4, 4),
    )

    with pytest.raises(MessageError, match="expected 2 joints, got 3"):
        subject.on_context_roi_joints(**exposure(0, 9, joints=3))
    with pytest.raises(MessageError, match="expected rgb8 pixels, got bayer_rggb8"):
        subject.on_context_roi_joints(**(given | {"roi": raw}))


@pytest.mark.parametrize("wrong", [{"decay": -1}, {"ahead": 0}, {"ahead": 1000}])
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        ActionChunkingSettings(**wrong)
