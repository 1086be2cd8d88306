"""Write torch networks and their metadata as ONNX; for training only."""

import warnings
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import TypeVar

import onnx
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Net = TypeVar("Net", bound=nn.Module)
OPSET = 17


def write(
    module: nn.Module,
    given: Mapping[str, Tensor],
    path: Path,
    outputs: tuple[str, ...],
    *,
    open_sides: Mapping[str, Mapping[int, str]] | None = None,
    **facts: str,
) -> None:
    """Trace a network, wherever it is, with example inputs; `facts` become metadata.

    `open_sides` names the sides of inputs and outputs that may vary.
    """
    with warnings.catch_warnings():
        # the older exporter keeps the parameters' names, by which they can be loaded back
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            deepcopy(module).cpu().eval(),
            tuple(given.values()),
            path,
            input_names=list(given),
            output_names=list(outputs),
            dynamic_axes={name: dict(sides) for name, sides in (open_sides or {}).items()},
            opset_version=OPSET,
            dynamo=False,
        )
    if facts:
        describe(path, facts)


def describe(path: Path, facts: Mapping[str, str]) -> None:
    """Add facts to a network's metadata; those of the same name are replaced."""
    model = onnx.load(path)
    known = {p.key: p.value for p in model.metadata_props}
    onnx.helper.set_model_props(model, known | dict(facts))
    onnx.save(model, path)


def fused(net: Net) -> Net:
    """A copy whose batch norms are folded into their convolutions, under the same names.

    Exported weights then keep names by which they can be loaded back.
    """
    net = deepcopy(net).eval()
    for block in net.modules():
        if isinstance(block, nn.Sequential) and isinstance(block[1], nn.BatchNorm2d):
            block[0] = fuse_conv_bn_eval(block[0], block[1])
            block[1] = nn.Identity()
    return net
