"""Groups of weights for an optimiser, and a running mean of weights over steps."""

# mypy: disallow-untyped-decorators=False
from typing import Any

import torch
from torch import nn


def groups(net: nn.Module, decay: float) -> list[dict[str, Any]]:
    """Weights that decay, and biases and norms, which do not."""
    matrices = [p for p in net.parameters() if p.ndim > 1]
    others = [p for p in net.parameters() if p.ndim <= 1]
    return [
        {"params": matrices, "weight_decay": decay},
        {"params": others, "weight_decay": 0.0},
    ]


@torch.no_grad()
def follow(mean: nn.Module, net: nn.Module, step: int) -> None:
    """Move the mean weights towards the newest, faster while young."""
    keep = min(0.9993, (1 + step) / (10 + step))
    new = net.state_dict()
    for name, old in mean.state_dict().items():
        if old.dtype.is_floating_point:
            old.lerp_(new[name], 1 - keep)
        else:
            old.copy_(new[name])
