"""MobileNetV3-Small (Howard et al. 2019, table 2): crops (n, 3, S, S) RGB -> 576 features.

Own implementation of the published table. The modules are named as in torchvision, so that its
ImageNet weights can be loaded (`load_imagenet`). Of the published 2.5 million parameters, 0.9 are
the trunk; the rest, the head for the classes of ImageNet, is replaced: one layer classifies the
object, with a class for false candidates, and the features identify it.
"""

# mypy: disallow-subclassing-any=False
from itertools import zip_longest
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from operators.training.checkpoint import read
from pipeline.errors import WeightsError

FEATURES = 576
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
# mean and deviation of RGB 0..1 in ImageNet, by which its networks normalise inputs
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


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
    """Squeeze and excite: each channel is weighted by a function of all channels' means."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        narrow = rounded(channels / 4)
        self.fc1 = nn.Conv2d(channels, narrow, 1)
        self.fc2 = nn.Conv2d(narrow, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        weight = self.fc2(F.relu(self.fc1(F.adaptive_avg_pool2d(x, 1))))
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
    """The trunk and its head."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [convolution(3, 16, 3, 2, act=nn.Hardswish)]
        width = 16
        for kernel, wide, out, excite, swish, stride in TABLE:
            layers.append(Bottleneck(width, kernel, wide, out, excite, swish, stride))
            width = out
        layers.append(convolution(width, FEATURES, 1, act=nn.Hardswish))
        self.features = nn.Sequential(*layers)
        self.pool = nn.AdaptiveAvgPool2d(1)
        self.kind = nn.Linear(FEATURES, len(CLASSES))

    def forward(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """Crops (n, 3, S, S), RGB 0..1 -> features (n, 576), logits of `CLASSES` (n, 4).

        Each row of features has mean 0 and deviation 1, so that a dot product compares two of them
        and a following LayerNorm does not change them.
        """
        seen = self.pool(self.features(crops)).flatten(1)
        return F.layer_norm(seen, (FEATURES,)), self.kind(seen)


def rounded(channels: float) -> int:
    """Round to the nearest multiple of 8, at least 8 and at least 0.9 times the value.

    >>> rounded(4), rounded(18), rounded(72 / 4), rounded(24)
    (8, 24, 24, 24)
    """
    found = max(8, int(channels + 4) // 8 * 8)
    return found if found >= 0.9 * channels else found + 8


def load_imagenet(net: EncoderNet, path: Path) -> None:
    """Begin with ImageNet weights: a state dict of torchvision's or timm's MobileNetV3-Small.

    Both list the trunk's tensors in the order of its layers, under names of their own. Raises
    `WeightsError` naming the first that is missing or of another shape.
    """
    state = read(path)
    state = {str(name): value for name, value in state.get("state_dict", state).items()}
    given = {name: value for name, value in state.items() if not of_head(name)}
    own = {name: value for name, value in net.features.state_dict().items() if not of_head(name)}
    pairs = zip_longest(own.items(), given.items(), fillvalue=("", None))
    for (name, wanted), (known, got) in pairs:
        if wanted is None or got is None or wanted.shape != got.shape:
            raise WeightsError(
                f"{path}: expected {shape_of(name, wanted)}, got {shape_of(known, got)}; "
                "is it a MobileNetV3-Small?"
            )
    loaded = dict(zip(own, given.values(), strict=True))
    net.features.load_state_dict(loaded, strict=False)
    take_plain(net.features[0])


def take_plain(stem: nn.Sequential) -> None:
    """Fold ImageNet's normalisation into the first layer.

    Exact except at the picture's edge, where the padding now means black.
    """
    kernel, norm = stem[0].weight, stem[1]
    with torch.no_grad():
        kernel /= torch.tensor(DEVIATION)[:, None, None]
        norm.running_mean += (kernel * torch.tensor(MEAN)[:, None, None]).sum((1, 2, 3))


def of_head(name: str) -> bool:
    """Whether an entry belongs to the head, not to the trunk."""
    return "classifier" in name or "conv_head" in name or name.endswith("num_batches_tracked")


def shape_of(name: str, value: Tensor | None) -> str:
    """An entry in words."""
    return "nothing more" if value is None else f"{name} of {tuple(value.shape)}"
