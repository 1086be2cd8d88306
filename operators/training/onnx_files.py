"""Write torch networks and their metadata as ONNX; for training only."""

import warnings
from collections.abc import Mapping
from copy import deepcopy
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import onnx
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from pipeline.whole_file import write_whole

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

    `open_sides` names the sides of inputs and outputs that may vary. The file is whole or, on a
    full disk, what it was before.
    """
    whole = BytesIO()
    with warnings.catch_warnings():
        # the older exporter keeps the parameters' names, by which they can be loaded back
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            deepcopy(module).cpu().eval(),
            tuple(given.values()),
            whole,
            input_names=list(given),
            output_names=list(outputs),
            dynamic_axes={name: dict(sides) for name, sides in (open_sides or {}).items()},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load_from_string(whole.getvalue())
    _write(model, path, facts)


def describe(path: Path, facts: Mapping[str, str]) -> None:
    """Add facts to a network's metadata; those of the same name are replaced."""
    _write(onnx.load(path), path, facts)


def _write(model: onnx.ModelProto, path: Path, facts: Mapping[str, str]) -> None:
    known = {p.key: p.value for p in model.metadata_props}
    onnx.helper.set_model_props(model, known | dict(facts))
    write_whole(path, model.SerializeToString())


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
