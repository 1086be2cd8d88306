"""An exported detector can be trained on: its weights are taken back, and it says the same."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper

from operators.saliency.data import Batch
from operators.saliency.example import INPUT_PX
from operators.saliency.initial import from_onnx
from operators.saliency.model import DetectorNet, Exported
from operators.saliency.saliency import SHIPPED
from pipeline import WeightsError
from pipeline.inference import Network
from tests.operators.networks import constant_network
from tests.operators.saliency.exported import exported_detector


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported_detector(tmp_path_factory.mktemp("exported"))


def batch() -> Batch:
    made = torch.Generator().manual_seed(1)
    pictures = torch.randint(0, 256, (4, 3, 96, 160), dtype=torch.uint8, generator=made)
    empty = torch.zeros(4, 1)
    return Batch(
        pictures=pictures, boxes=torch.zeros(4, 1, 4), labels=empty, ignored=empty,
        difference=torch.randint(-99, 99, (4, 1, 96, 160), dtype=torch.int8, generator=made),
    )  # fmt: skip


def test_the_network_says_what_the_file_says(exported: Path) -> None:
    net = DetectorNet()
    pictures = batch().pictures[:1].float() / 255

    from_onnx(exported, net, batch())

    with torch.no_grad():
        output, features = Exported(net.eval())(pictures)
    said = Network(exported, threads=1)({"images": pictures.numpy()})
    # all but the ball's scores, whose peaks are among equals in a network without training
    assert np.allclose(output.numpy()[:, :6], said["output"][:, :6], atol=1e-2)
    assert np.allclose(features.numpy(), said["features"], atol=1e-3)


def test_norms_remember_what_they_see(exported: Path) -> None:
    net = DetectorNet()
    from_onnx(exported, net, batch())
    pictures = batch().pictures.float() / 255

    with torch.no_grad():
        remembered = net.eval()(pictures).features
        shown = net.train()(pictures).features

    assert (remembered - shown).abs().max() < 0.05 * remembered.abs().max()


def test_a_head_for_a_moving_ball_begins_as_the_one_for_a_still_ball(exported: Path) -> None:
    net, plain = DetectorNet(difference=True), DetectorNet()

    from_onnx(exported, net, batch())
    from_onnx(exported, plain, batch())

    with torch.no_grad():
        found = net.eval()(batch().inputs(net.channels))
        wanted = plain.eval()(batch().inputs(plain.channels))
    assert found.moving is not None
    assert torch.allclose(found.heat, wanted.heat, atol=1e-5)
    assert torch.allclose(found.moving[0], wanted.heat, atol=1e-5)
    assert torch.allclose(found.scores, wanted.scores, atol=1e-5)


def test_what_reads_the_difference_is_taken_back_too(tmp_path: Path) -> None:
    path, net = exported_detector(tmp_path, difference=True), DetectorNet(difference=True)

    from_onnx(path, net, batch())

    pictures = batch().inputs(4)[:1]
    with torch.no_grad():
        output, _ = Exported(net.eval())(pictures)
    said = Network(path, threads=1)({"images": pictures.numpy()})["output"]
    assert np.allclose(output.numpy()[:, :6], said[:, :6], atol=1e-2)


def test_weights_in_eight_bits_are_taken_back_nearly_as_they_were() -> None:
    was, now = DetectorNet(), DetectorNet()

    from_onnx(SHIPPED, was, batch())
    from_onnx(SHIPPED.with_name("detector_int8.onnx"), now, batch())

    with torch.no_grad():
        before, after = was.eval()(batch().inputs(3)), now.eval()(batch().inputs(3))
    pairs = [(before.scores, after.scores), (before.heat, after.heat)]
    pairs.append((before.features, after.features))
    for one, other in pairs:
        assert torch.corrcoef(torch.stack([one.flatten(), other.flatten()]))[0, 1] > 0.97


@pytest.mark.parametrize(
    ("tensor", "value", "said"),
    [
        ("net.ball.detail.0.weight_scale", np.ones(3, np.float32), "a scale of each channel of"),
        ("net.ball.detail.0.weight_zero_point", np.full(32, 20, np.int8), "around zero"),
        ("net.ball.heat.bias", np.full(1, np.nan, np.float32), "expected finite numbers"),
        ("net.ball.heat.bias", np.array(["a"], np.object_), "expected an ONNX file"),
    ],
)
def test_damaged_weights_in_eight_bits_are_refused(
    tensor: str, value: NDArray[Any], said: str, tmp_path: Path
) -> None:
    model = onnx.load(SHIPPED.with_name("detector_int8.onnx"))
    (found,) = (i for i in model.graph.initializer if i.name == tensor)
    found.CopyFrom(numpy_helper.from_array(value, tensor))
    onnx.save(model, tmp_path / "other.onnx")

    with pytest.raises(WeightsError, match=said):
        from_onnx(tmp_path / "other.onnx", DetectorNet(), batch())


def test_another_network_is_refused(tmp_path: Path) -> None:
    other = constant_network(tmp_path / "n.onnx", np.zeros((1, 7, 10), np.float32))

    with pytest.raises(WeightsError, match=r"n\.onnx: expected this detector's .*, got none"):
        from_onnx(Path(other), DetectorNet(), batch())
    (tmp_path / "broken.onnx").write_bytes(b"\x00no")
    with pytest.raises(WeightsError, match=r"broken\.onnx: expected an ONNX file, got"):
        from_onnx(tmp_path / "broken.onnx", DetectorNet(), batch())


@pytest.mark.parametrize("size", [(480, 288), (256, 160)])
def test_the_file_takes_pictures_of_any_sides_that_are_multiples_of_32(
    exported: Path, size: tuple[int, int]
) -> None:
    width, height = size

    said = Network(exported, threads=1)({"images": np.zeros((1, 3, height, width), np.float32)})

    people = sum((width // s) * (height // s) for s in (8, 16, 32))
    assert said["output"].shape == (1, 7, people + width * height // 16)
    assert said["features"].shape == (1, 64, height // 8, width // 8)
    assert INPUT_PX == (480, 288)
