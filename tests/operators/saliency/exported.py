"""A detector of random weights as a file, for tests that must not depend on the shipped one."""

from pathlib import Path

import torch

from operators.saliency.model import DetectorNet
from operators.saliency.training_run import export


def exported_detector(folder: Path, *, difference: bool = False) -> Path:
    """Export a network whose norms have seen something."""
    torch.manual_seed(3)
    net = DetectorNet(difference=difference)
    with torch.no_grad():
        net(torch.rand(2, net.channels, 96, 160))
        for values in net.parameters():  # the exporter stores equal values once
            values.add_(torch.randn(values.shape) * 1e-3)
    path = folder / "detector.onnx"
    export(net, path)
    return path
