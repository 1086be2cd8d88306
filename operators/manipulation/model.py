"""The network of the consumer: a picture and the joints in, the targets of the next steps out.

Action chunking with transformers (Zhao et al., 2023) with an image encoder that a single core can
train: few convolutions, whose maps are read at a few points each (a softmax over places), because
where peg and socket are is all that varies between trials.
"""

# mypy: disallow-subclassing-any=False
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from operators.manipulation.picture import PICTURE_PX, WORKPLACE
from operators.training import onnx_files

JOINTS = 14
SHARP = 8.0
INPUTS = ("picture", "joints")


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Sides of the network."""

    chunk: int = 100  # steps that are told at once
    points: int = 32
    width: int = 128
    heads: int = 4
    inner: int = 256  # of a feed-forward part
    layers: int = 2  # of the encoder and of the decoder
    style: int = 16  # numbers that tell one demonstration from another


class Eyes(nn.Module):
    """Pictures to features at points: where each map looks, and what is there."""

    def __init__(self, points: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            _block(3, 16, size=5, stride=2),
            _block(16, 32, stride=2),
            _block(32, 48),
            _block(48, 48, dilation=2),
        )
        self.maps = nn.Conv2d(48, points, 1)
        # a map as flat as at first looks everywhere at once, and hardly moves with an object
        self.sharpness = nn.Parameter(torch.full((points, 1, 1), SHARP))

    def forward(self, picture: Tensor) -> Tensor:
        """(B, h, w, 3) of 0..255 -> (B, points, 2 + 48): place in -1..1, features."""
        seen = self.body(picture.permute(0, 3, 1, 2).float() / 255 - 0.4)
        maps = self.maps(seen).float() * self.sharpness
        rows, columns = maps.shape[2:]
        chance = maps.flatten(2).softmax(2)  # (B, K, rows * columns)
        places = chance @ _grid(rows, columns).to(chance)  # (B, K, 2)
        what = chance @ seen.float().flatten(2).transpose(1, 2)  # (B, K, 48)
        return torch.cat([places, what], 2)


class ActNet(nn.Module):
    """Targets of the next steps; inputs and outputs in their own units, scaled inside."""

    mean: Tensor
    spread: Tensor

    def __init__(self, shape: Shape, mean: Tensor, spread: Tensor) -> None:
        super().__init__()
        self.shape, width = shape, shape.width
        self.register_buffer("mean", mean)  # (14,), of all targets
        self.register_buffer("spread", spread)
        self.eyes = Eyes(shape.points)
        self.of_points = nn.Linear(2 + 48, width)
        self.of_joints = nn.Linear(JOINTS, width)
        self.of_style = nn.Linear(shape.style, width)
        self.names = nn.Parameter(torch.randn(shape.points + 2, width) * 0.02)
        self.style = Style(shape)
        self.encoder = nn.TransformerEncoder(
            _layer(nn.TransformerEncoderLayer, shape), shape.layers, enable_nested_tensor=False
        )
        self.queries = nn.Parameter(torch.randn(shape.chunk, width) * 0.02)
        self.decoder = nn.TransformerDecoder(
            _layer(nn.TransformerDecoderLayer, shape), shape.layers
        )
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, JOINTS))

    def forward(self, picture: Tensor, joints: Tensor, style: Tensor | None = None) -> Tensor:
        """(B, h, w, 3) uint8 and (B, 14) -> (B, chunk, 14); style (B, style), missing: its mean."""
        if style is None:
            style = joints.new_zeros(joints.shape[0], self.shape.style)
        return self.tell(self.eyes(picture), joints, style)

    def tell(self, seen: Tensor, joints: Tensor, style: Tensor) -> Tensor:
        """What the eyes saw (B, points, 2 + 48), joints (B, 14), style -> (B, chunk, 14)."""
        scaled = (joints - self.mean) / self.spread
        tokens = torch.cat(
            [
                self.of_points(seen),
                self.of_joints(scaled)[:, None],
                self.of_style(style)[:, None],
            ],
            1,
        )
        memory = self.encoder(tokens + self.names)
        queries = self.queries.expand(joints.shape[0], -1, -1)
        told = self.out(self.decoder(queries, memory))
        return told.float() * self.spread + self.mean


class Style(nn.Module):
    """What a demonstration does in its own way: joints and targets to a normal distribution."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.given = nn.Linear(JOINTS * (1 + -(-shape.chunk // 10)), shape.width)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(shape.width, 2 * shape.style))

    def forward(self, joints: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled (B, 14) and (B, chunk, 14) -> mean and logarithm of the variance (B, style)."""
        told = torch.cat([joints[:, None], targets[:, ::10]], 1).flatten(1)
        mean, variance = self.out(self.given(told)).chunk(2, 1)
        return mean, variance


def loss_of(
    net: ActNet,
    picture: Tensor,
    joints: Tensor,
    targets: Tensor,
    places: Tensor,
    *,
    divergence: float,
    guide: float,
) -> tuple[Tensor, Tensor]:
    """Return the loss and the mean absolute error in units of `spread`.

    `places` (B, m, 2) are where the first m points are to look, NaN where that is not known: the
    targets alone take thousands of steps to teach it. `guide` is the weight of that.
    """
    mean, variance = net.style((joints - net.mean) / net.spread, (targets - net.mean) / net.spread)
    style = mean + torch.randn_like(mean) * (variance / 2).exp()
    seen = net.eyes(picture)
    told = net.tell(seen, joints, style)
    known = places.isfinite()
    aside = (seen[:, : places.shape[1], :2] - places.nan_to_num()).abs() * known
    error = functional.l1_loss(told / net.spread, targets / net.spread)
    apart = -0.5 * (1 + variance - mean**2 - variance.exp()).sum(1).mean()
    aimed = aside.sum() / known.sum().clamp(min=1)
    return error + divergence * apart + guide * aimed, error.detach()


def export(net: ActNet, path: Path) -> None:
    """Write the network without the part for styles as ONNX."""
    width, height = PICTURE_PX
    net = net.cpu().eval()
    given = {
        "picture": torch.zeros(1, height, width, 3, dtype=torch.uint8),
        "joints": torch.zeros(1, JOINTS),
    }
    fast = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)  # its fused operation has no ONNX
    try:
        with warnings.catch_warnings():
            # torch's own attention checks its shapes, which the trace takes for decisions
            warnings.simplefilter("ignore", torch.jit.TracerWarning)
            onnx_files.write(net, given, path, ("targets",))
        facts = {name: str(value) for name, value in asdict(net.shape).items()}
        onnx_files.describe(path, facts | {"workplace": " ".join(f"{s:g}" for s in WORKPLACE)})
    finally:
        torch.backends.mha.set_fastpath_enabled(fast)


def _block(
    given: int, out: int, *, size: int = 3, stride: int = 1, dilation: int = 1
) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(
            given, out, size, stride, padding=dilation * (size // 2), dilation=dilation, bias=False
        ),
        nn.BatchNorm2d(out),
        nn.ReLU(inplace=True),
    )


def _layer(kind: type[nn.Module], shape: Shape) -> nn.Module:
    return kind(
        shape.width, shape.heads, shape.inner, dropout=0.0, batch_first=True, norm_first=True
    )


def _grid(rows: int, columns: int) -> Tensor:
    """Places (rows * columns, 2) of a map's cells, x and y in -1..1."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, rows), torch.linspace(-1, 1, columns), indexing="ij"
    )
    return torch.stack([x.flatten(), y.flatten()], 1)
