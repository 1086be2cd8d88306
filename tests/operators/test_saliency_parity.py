"""ONNX Runtime computes what torch computes: a fresh network, and the shipped ones."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import onnx
import torch

from operators.saliency.example import BALL, NAMES
from operators.saliency.model import DetectorNet, Exported
from operators.saliency.saliency import SHIPPED as SHIPPED_DETECTOR
from operators.saliency.training_run import export
from operators.training.onnx_files import fused
from pipeline.inference import Network

TOLERANCE = {"rtol": 1e-3, "atol": 1e-3}


def fresh(seed: int) -> DetectorNet:
    """Return an untrained network with batch norms that are not the identity."""
    torch.manual_seed(seed)
    net = DetectorNet()
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
        elif isinstance(module, torch.nn.Conv2d):
            # by default activations fade with depth, and peaks of a flat map are mere rounding
            torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    return net.eval()


def loaded(path: Path, module: torch.nn.Module) -> torch.nn.Module:
    """Return the torch module with all weights of an ONNX file, by name."""
    stored = {
        i.name: torch.from_numpy(onnx.numpy_helper.to_array(i).copy())
        for i in onnx.load(path).graph.initializer
    }
    module = fused(module)
    module.load_state_dict({name: stored[name] for name in module.state_dict()})
    return module


def picture(seed: int, count: int, height_px: int, width_px: int) -> np.ndarray:
    """Return random pictures in 0..1."""
    return np.random.default_rng(seed).random((count, 3, height_px, width_px), np.float32)


def assert_same_output(got: np.ndarray, wanted: np.ndarray) -> None:
    """Assert that all rows agree; of two adjacent cells of equal heat either may be the peak."""
    ball = 4 + NAMES.index(BALL)
    np.testing.assert_allclose(got[:, :ball], wanted[:, :ball], **TOLERANCE)
    peaks = (got[:, ball] > 0) & (wanted[:, ball] > 0)
    np.testing.assert_allclose(got[:, ball][peaks], wanted[:, ball][peaks], **TOLERANCE)
    undecided = (got[:, ball] > 0) != (wanted[:, ball] > 0)
    assert undecided.sum() < 0.01 * peaks.sum()


def test_an_exported_network_computes_what_torch_computes(tmp_path: Path) -> None:
    net = fresh(seed=3)
    export(net, tmp_path / "detector.onnx")
    images = picture(5, 1, 288, 480)

    got = Network(tmp_path / "detector.onnx")({"images": images})

    with torch.no_grad():
        output, features = Exported(net)(torch.from_numpy(images))
    assert_same_output(got["output"], output.numpy())
    np.testing.assert_allclose(got["features"], features, **TOLERANCE)


def test_the_shipped_detector_is_the_network_of_model_py_with_features_of_another() -> None:
    images = picture(5, 1, 288, 480)
    network = Network(SHIPPED_DETECTOR)

    got = network({"images": images})

    with torch.no_grad():
        output, own = loaded(SHIPPED_DETECTOR, Exported(DetectorNet()))(torch.from_numpy(images))
        stored = {i.name: i for i in onnx.load(SHIPPED_DETECTOR).graph.initializer}
        kernel, offset = (
            torch.from_numpy(onnx.numpy_helper.to_array(stored[f"alignment.{part}"]).copy())
            for part in ("weight", "bias")
        )
        features = torch.relu(torch.nn.functional.conv2d(own, kernel, offset))
    assert_same_output(got["output"], output.numpy())
    np.testing.assert_allclose(got["features"], features, **TOLERANCE)
    assert network.metadata["names"] == str(dict(enumerate(NAMES)))
