"""Weights of an exported detector -> a network that can be trained on.

An exported network has its batch norms folded into the convolutions. They are unfolded here by
measuring what each convolution gives on training pictures: the network then says the same whether
its norms use what they remember or what the batch shows.
"""

# mypy: disallow-untyped-decorators=False
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from operators.saliency.data import Batch
from operators.saliency.model import DetectorNet
from pipeline.errors import WeightsError

PREFIX = "net."
MOVING = "moving."
QUANTISED = "_quantized"  # what ONNX Runtime calls a tensor in whole numbers


@torch.no_grad()
def from_onnx(path: Path, net: DetectorNet, batch: Batch) -> None:
    """Load an ONNX file of `export` into a network; raises `WeightsError` for any other file.

    One in eight bits gives its weights as they were rounded. Of a file without a head for a moving
    ball that head begins as the one for a still ball.
    """
    found = _initialisers(path)
    new = () if any(name.startswith(PREFIX + MOVING) for name in found) else (MOVING,)
    blocks = {name: block for name, block in _normed(net) if not name.startswith(new)}
    for name, wanted in net.named_parameters():
        if name.startswith(new):
            continue
        block = blocks.get(name.rpartition(".")[0].rpartition(".")[0])
        if block is None:
            _fill(wanted, found, name, path)
    for name, block in blocks.items():
        _fill(block[0].weight, found, f"{name}.0.weight", path)
        _fill(block[1].bias, found, f"{name}.0.bias", path)
        block[1].weight.fill_(1)
        block[1].running_mean.zero_()
        block[1].running_var.fill_(1 - block[1].eps)
    _unfold(net, blocks, batch)
    if new and net.moving is not None:
        net.moving.load_state_dict(net.ball.state_dict(), strict=False)


def _unfold(net: DetectorNet, blocks: dict[str, nn.Sequential], batch: Batch) -> None:
    """Give each norm the mean and variance that it sees, with what it gives unchanged."""
    seen: dict[str, tuple[Tensor, Tensor]] = {}

    def note(name: str, _: nn.Module, __: object, out: Tensor) -> None:
        seen[name] = out.mean((0, 2, 3)), out.var((0, 2, 3), unbiased=False)

    hooks = [b[0].register_forward_hook(partial(note, name)) for name, b in blocks.items()]
    net.eval()(batch.inputs(net.channels))
    for hook in hooks:
        hook.remove()
    for name, block in blocks.items():
        mean, variance = seen[name]
        convolution, norm = block[0], block[1]
        # a norm undoes any scale before it: with the usual one, steps have their usual effect
        usual = (3 * convolution.weight[0].numel()) ** -0.5
        gain = usual / convolution.weight.std().clamp(min=1e-12)
        convolution.weight.mul_(gain)
        norm.weight.copy_((variance + norm.eps / gain**2).sqrt())
        norm.bias.add_(mean)
        norm.running_mean.copy_(mean * gain)
        norm.running_var.copy_(variance * gain**2)


def _normed(net: nn.Module) -> Iterator[tuple[str, nn.Sequential]]:
    for name, block in net.named_modules():
        if isinstance(block, nn.Sequential) and isinstance(block[1], nn.BatchNorm2d):
            yield name, block


def _initialisers(path: Path) -> dict[str, Tensor]:
    try:
        model = onnx.load(path)
        arrays = {i.name: numpy_helper.to_array(i) for i in model.graph.initializer}
        known = {name: torch.tensor(array) for name, array in arrays.items()}
    except Exception as error:  # protobuf raises kinds of its own
        raise WeightsError(f"{path}: expected an ONNX file, got {error}") from error
    for name in [name for name in known if name.endswith(QUANTISED)]:
        own = name.removesuffix(QUANTISED)
        scale, zero = (
            known.get(own + end, known.get(name + end)) for end in ("_scale", "_zero_point")
        )
        # one scale, or one of each channel; what `quantise` writes lies around zero
        if scale is None or scale.shape not in ((), known[name].shape[:1]):
            raise WeightsError(f"{path}: expected a scale of each channel of {own}, got none")
        if zero is not None and zero.any():
            raise WeightsError(f"{path}: expected {own} around zero, got another zero point")
        known[own] = (known[name].float().movedim(0, -1) * scale).movedim(-1, 0)
    return known


def _fill(wanted: Tensor, found: dict[str, Tensor], name: str, path: Path) -> None:
    given = found.get(PREFIX + name)
    if given is None or given.shape != wanted.shape:
        got = "none" if given is None else str(tuple(given.shape))
        what = f"expected this detector's {name} {tuple(wanted.shape)}"
        raise WeightsError(f"{path}: {what}, got {got}")
    if not given.isfinite().all():
        raise WeightsError(f"{path}: expected finite numbers in {name}, got others")
    wanted.copy_(given)
