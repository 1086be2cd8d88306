"""MobileNetV3-Small (Howard et al. 2019, table 2): crops (n, 3, S, S) RGB -> 576 features.

Own code after the published table. The modules are named as in torchvision, so that its ImageNet
weights load as they are (`load_imagenet`). Two heads stand on the features: what the object is, a
false candidate included, and for training alone who it is.
"""

# mypy: disallow-subclassing-any=False
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pipeline.errors import WeightsError

FEATURES, WIDE, IDENTITY = 576, 1024, 128
CLASSES = ("player", "referee", "ball", "background")
# kernel, expanded, out, squeeze and excite, hard swish, stride
TABLE = (
    (3, 16, 16, True, False, 2),
    (3, 72, 24, False, False, 2),
    (3, 88, 24, False, False, 1),
    (5, 96, 40, True, True, 2),
    (5, 240, 40, True, True, 1),
    (5, 240, 40, True, True, 1),
    (5, 120, 48, True, True, 1),
    (5, 144, 48, True, True, 1),
    (5, 288, 96, True, True, 2),
    (5, 576, 96, True, True, 1),
    (5, 576, 96, True, True, 1),
)
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's RGB, 0..1


def convolution(
    inputs: int,
    outputs: int,
    kernel: int,
    stride: int = 1,
    groups: int = 1,
    act: type | None = None,
) -> nn.Sequential:
    """Convolution, batch norm and, where given, an activation."""
    parts: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.03),
    ]
    return nn.Sequential(*parts, *([act()] if act else []))


class Excite(nn.Module):
    """Squeeze and excite: each channel is weighted by what all of them show."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        narrow = rounded(channels / 4)
        self.fc1 = nn.Conv2d(channels, narrow, 1)
        self.fc2 = nn.Conv2d(narrow, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        weight = self.fc2(F.relu(self.fc1(x.mean((2, 3), keepdim=True))))
        return x * F.hardsigmoid(weight)


class Bottleneck(nn.Module):
    """Expand, filter each channel, weight, project; added to the input where sizes allow."""

    def __init__(
        self, inputs: int, kernel: int, wide: int, out: int, excite: bool, swish: bool, stride: int
    ) -> None:
        super().__init__()
        act = nn.Hardswish if swish else nn.ReLU
        parts: list[nn.Module] = []
        if wide != inputs:
            parts.append(convolution(inputs, wide, 1, act=act))
        parts.append(convolution(wide, wide, kernel, stride, wide, act))
        if excite:
            parts.append(Excite(wide))
        parts.append(convolution(wide, out, 1))
        self.block = nn.Sequential(*parts)
        self.same = stride == 1 and inputs == out

    def forward(self, x: Tensor) -> Tensor:
        return x + self.block(x) if self.same else self.block(x)


class EncoderNet(nn.Module):
    """The trunk and its heads."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [convolution(3, 16, 3, 2, act=nn.Hardswish)]
        width = 16
        for kernel, wide, out, excite, swish, stride in TABLE:
            layers.append(Bottleneck(width, kernel, wide, out, excite, swish, stride))
            width = out
        layers.append(convolution(width, FEATURES, 1, act=nn.Hardswish))
        self.features = nn.Sequential(*layers)
        self.kind = nn.Linear(FEATURES, len(CLASSES))
        self.classifier = nn.Sequential(nn.Linear(FEATURES, WIDE), nn.Hardswish())
        self.identity = nn.Linear(WIDE, IDENTITY)
        self.register_buffer("mean", torch.tensor(MEAN)[:, None, None])
        self.register_buffer("deviation", torch.tensor(DEVIATION)[:, None, None])

    def trunk(self, crops: Tensor) -> Tensor:
        """Crops (n, 3, S, S), RGB 0..1 -> (n, 576)."""
        return self.features((crops - self.mean) / self.deviation).mean((2, 3))

    def forward(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of classes (n, 4), and vectors of length 1 that tell who it is (n, 128)."""
        seen = self.trunk(crops)
        return self.kind(seen), F.normalize(self.identity(self.classifier(seen)), dim=1)


class Exported(nn.Module):
    """What runs live: features and classes."""

    def __init__(self, net: EncoderNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        seen = self.net.trunk(crops)
        return seen, self.net.kind(seen)


def rounded(channels: float) -> int:
    """To the nearest multiple of 8, at least 8, never below nine tenths of it.

    >>> rounded(4), rounded(18), rounded(72 / 4), rounded(24)
    (8, 24, 24, 24)
    """
    found = max(8, int(channels + 4) // 8 * 8)
    return found if found >= 0.9 * channels else found + 8


def load_imagenet(net: EncoderNet, path: Path) -> None:
    """Begin with ImageNet weights: a state dict of torchvision's `mobilenet_v3_small`.

    Raises `WeightsError` naming the first entry that is missing or of another shape.
    """
    try:
        state: Mapping[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch raises many kinds for what is no state dict
        raise WeightsError(f"{path}: expected a state dict of tensors, got {error}") from error
    state = state.get("state_dict", state)
    state = {name.removeprefix("module."): value for name, value in state.items()}
    own = net.features.state_dict()
    wanted = {f"features.{name}": value.shape for name, value in own.items()}
    for name, shape in wanted.items():
        got = state.get(name)
        if got is None or got.shape != shape:
            found = "nothing" if got is None else tuple(got.shape)
            raise WeightsError(f"{path}: expected {name} of {tuple(shape)}, got {found}")
    net.features.load_state_dict({name: state[f"features.{name}"] for name in own})
