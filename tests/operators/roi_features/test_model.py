"""The network is MobileNetV3-Small, gives the same in ONNX and torch, and loads its weights."""

from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from torch import Tensor

from operators.roi_features.model import (
    CLASSES,
    DEVIATION,
    FEATURES,
    MEAN,
    EncoderNet,
    load_imagenet,
)
from operators.roi_features.roi_features import SHIPPED
from operators.roi_features.training_run import export
from pipeline import WeightsError
from pipeline.inference import Network


def fresh(seed: int) -> EncoderNet:
    """Return an untrained network with batch norms that are not the identity."""
    torch.manual_seed(seed)
    net = EncoderNet()
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
    return net.eval()


def as_published(net: EncoderNet) -> OrderedDict[str, Tensor]:
    """Return its state dict as torchvision writes it, with the head for ImageNet's classes."""
    state = OrderedDict((f"features.{n}", v) for n, v in net.features.state_dict().items())
    state["classifier.0.weight"] = torch.zeros(1024, FEATURES)
    state["classifier.3.weight"] = torch.zeros(1000, 1024)
    return state


def test_with_its_imagenet_head_it_has_the_published_number_of_parameters() -> None:
    trunk = sum(p.numel() for p in EncoderNet().features.parameters())
    head = (FEATURES + 1) * 1024 + (1024 + 1) * 1000

    assert trunk == 927_008
    assert trunk + head == 2_542_856  # torchvision's count of mobilenet_v3_small


def test_features_have_the_same_scale_for_any_crop() -> None:
    crops = torch.rand(3, 3, 96, 96, generator=torch.Generator().manual_seed(4))
    crops[1] *= 0.1

    features, classes = fresh(4)(crops)

    assert features.shape == (3, FEATURES)
    assert classes.shape == (3, len(CLASSES))
    assert features.mean(1).detach().numpy() == pytest.approx(np.zeros(3), abs=1e-5)
    assert features.std(1).detach().numpy() == pytest.approx(np.ones(3), abs=1e-2)


@pytest.mark.parametrize("count", [1, 5])
def test_onnx_computes_what_torch_computes(tmp_path: Path, count: int) -> None:
    net = fresh(7)
    crops = np.random.default_rng(7).random((count, 3, 96, 96), np.float32)

    export(net, tmp_path / "e.onnx")
    got = Network(tmp_path / "e.onnx")({"crops": crops})

    with torch.no_grad():
        features, classes = net(torch.from_numpy(crops))
    np.testing.assert_allclose(got["features"], features.numpy(), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(got["classes"], classes.numpy(), rtol=1e-3, atol=1e-3)


def test_the_shipped_network_names_its_classes_and_has_these_outputs() -> None:
    shipped = Network(SHIPPED)

    assert shipped.metadata["classes"].split() == list(CLASSES)
    assert list(shipped.outputs) == ["features", "classes"]
    assert shipped({"crops": np.zeros((2, 3, 96, 96), np.float32)})["features"].shape == (2, 576)


def test_weights_of_torchvision_load_and_include_the_normalisation(tmp_path: Path) -> None:
    given, net = fresh(1), fresh(2)
    torch.save(as_published(given), tmp_path / "w.pth")

    load_imagenet(net, tmp_path / "w.pth")

    crops = torch.rand(1, 3, 96, 96, generator=torch.Generator().manual_seed(0))
    mean, deviation = torch.tensor(MEAN)[:, None, None], torch.tensor(DEVIATION)[:, None, None]
    stem, wanted = net.features[0](crops), given.features[0]((crops - mean) / deviation)
    assert torch.allclose(stem[..., 1:, 1:], wanted[..., 1:, 1:], atol=1e-4)
    assert torch.equal(net.features[1:](wanted), given.features[1:](wanted))


def test_weights_under_other_names_load_in_their_order(tmp_path: Path) -> None:
    given, net = fresh(1), fresh(2)
    renamed = OrderedDict(
        (f"blocks.{i}", v)
        for i, (n, v) in enumerate(given.features.state_dict().items())
        if not n.endswith("num_batches_tracked")
    )
    torch.save({"state_dict": renamed}, tmp_path / "w.pth")

    load_imagenet(net, tmp_path / "w.pth")

    seen = torch.rand(1, 16, 48, 48, generator=torch.Generator().manual_seed(0))
    assert torch.equal(net.features[1:](seen), given.features[1:](seen))


def test_weights_of_another_network_are_refused_with_the_first_that_differs(tmp_path: Path) -> None:
    state = as_published(fresh(1))
    state["features.1.block.0.0.weight"] = torch.zeros(16, 1, 5, 5)
    torch.save(state, tmp_path / "w.pth")

    with pytest.raises(
        WeightsError, match=r"1\.block\.0\.0\.weight of \(16, 1, 3, 3\), got .*5, 5"
    ):
        load_imagenet(EncoderNet(), tmp_path / "w.pth")


def test_weights_that_end_early_are_refused(tmp_path: Path) -> None:
    state = list(as_published(fresh(1)).items())[:20]
    torch.save(OrderedDict(state), tmp_path / "w.pth")

    with pytest.raises(WeightsError, match="got nothing more"):
        load_imagenet(EncoderNet(), tmp_path / "w.pth")


@pytest.mark.parametrize("content", ["text", "tensor", "nothing"])
def test_a_file_that_is_no_state_dict_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "w.pth"
    if content == "text":
        path.write_text("not a network")
    elif content == "tensor":
        torch.save(torch.zeros(3), path)

    with pytest.raises(WeightsError, match=r"w\.pth: expected a state dict of tensors, got "):
        load_imagenet(EncoderNet(), path)
