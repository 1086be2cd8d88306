"""The shipped detector's network: pictures (B, 3, H, W) -> people at strides 8-32, a ball at 4.

Made with `difference` it takes a fourth channel, what changed since the frame before, and has a
second head for a ball that moves; where that one is surer, its ball is reported. People and
features do not depend on it.

Own design from published ideas: cross-stage blocks (Wang et al., CSPNet 2019) in plain 3x3
convolutions with ReLU, which ONNX Runtime fuses; a top-down and a bottom-up neck (Lin et al. 2017,
Liu et al. 2018); decoupled anchor-free heads that give distances to the box's sides (Tian et al.,
FCOS 2019); a heat-map for the ball (Zhou et al., CenterNet 2019), which at four pixels is too
small for a grid of eight. All widths are multiples of 16, the run-time's channel block.
"""

# mypy: disallow-subclassing-any=False
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from operators.saliency.example import PEOPLE

STRIDES = (8, 16, 32)
BALL_STRIDE = 4
FEATURES = 64  # channels of the stride-8 map


@dataclass(frozen=True, kw_only=True)
class Raw:
    """Outputs before decoding; A anchors over the strides 8, 16, 32, row by row."""

    scores: Tensor  # (B, A, people) logits
    boxes: Tensor  # (B, A, 4) xyxy, input pixels
    heat: Tensor  # (B, 1, H/4, W/4) logits: a ball's centre lies in this cell
    ball: Tensor  # (B, 4, H/4, W/4) centre's offset x, y from the cell's; log width, height; cells
    features: Tensor  # (B, FEATURES, H/8, W/8)
    moving: tuple[Tensor, Tensor] | None = None  # heat and ball of what reads the difference


def conv(inward: int, outward: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch norm, ReLU; size kept, or divided by the stride."""
    return nn.Sequential(
        nn.Conv2d(inward, outward, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outward),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Two 3x3 convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(conv(width, width), conv(width, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


class CrossStage(nn.Module):
    """One half goes through residuals, the other past them; 1x1 convolutions around both."""

    def __init__(self, inward: int, outward: int, half: int, depth: int = 1) -> None:
        super().__init__()
        # two projections and not one split: a split would leave the run-time's blocked layout
        self.past = conv(inward, half, 1)
        self.through = nn.Sequential(conv(inward, half, 1), *(Residual(half) for _ in range(depth)))
        self.join = conv(2 * half, outward, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.join(torch.cat([self.past(x), self.through(x)], 1))


class Surroundings(nn.Module):
    """Maxima over growing neighbourhoods beside the map itself (He et al., SPP 2014)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow = conv(width, width // 2, 1)
        self.join = conv(2 * width, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        maps = [self.narrow(x)]
        for _ in range(3):
            maps.append(F.max_pool2d(maps[-1], 5, 1, 2))
        return self.join(torch.cat(maps, 1))


class Backbone(nn.Module):
    """(B, 3, H, W) -> maps at strides 4, 8, 16, 32 with 48, 64, 128, 192 channels."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(conv(3, 16, 3, 2), conv(16, 32, 3, 2))
        self.stage4 = CrossStage(32, 48, 16)
        self.stage8 = nn.Sequential(conv(48, 64, 3, 2), CrossStage(64, 64, 32, 2))
        self.stage16 = nn.Sequential(conv(64, 128, 3, 2), CrossStage(128, 128, 64, 2))
        self.stage32 = nn.Sequential(
            conv(128, 192, 3, 2), CrossStage(192, 192, 96), Surroundings(192)
        )

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        x4 = self.stage4(self.stem(x))
        x8 = self.stage8(x4)
        x16 = self.stage16(x8)
        return x4, x8, x16, self.stage32(x16)


class Neck(nn.Module):
    """Mixes the scales: coarse maps tell fine ones what is there, fine ones tell where."""

    def __init__(self) -> None:
        super().__init__()
        self.coarse = conv(192, 96, 1)
        self.top16 = CrossStage(96 + 128, 96, 48)
        self.middle = conv(96, 64, 1)
        self.top8 = CrossStage(64 + 64, FEATURES, 32)
        self.down16 = conv(FEATURES, 64, 3, 2)
        self.out16 = CrossStage(64 + 96, 96, 48)
        self.down32 = conv(96, 96, 3, 2)
        self.out32 = CrossStage(96 + 96, 128, 64)

    def forward(self, x8: Tensor, x16: Tensor, x32: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x32 = self.coarse(x32)
        x16 = self.top16(torch.cat([_double(x32), x16], 1))
        n8 = self.top8(torch.cat([_double(self.middle(x16)), x8], 1))
        n16 = self.out16(torch.cat([self.down16(n8), x16], 1))
        return n8, n16, self.out32(torch.cat([self.down32(n16), x32], 1))


class PeopleHead(nn.Module):
    """One scale -> class logits (B, people, h, w) and log distances (B, 4, h, w) in strides."""

    def __init__(self, inward: int, width: int) -> None:
        super().__init__()
        self.scores = nn.Sequential(conv(inward, width), nn.Conv2d(width, len(PEOPLE), 1))
        self.sides = nn.Sequential(conv(inward, width), nn.Conv2d(width, 4, 1))
        # few cells hold a person: start by believing so, or the first steps only unlearn
        nn.init.constant_(self.scores[1].bias, -4.0)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.scores(x), self.sides(x)


class Changed(nn.Module):
    """What changed since the frame before (B, 1, H, W) -> its part in the ball's head, stride 4."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(conv(1, 16, 3, 2), conv(16, 32, 3, 2))
        self.join = nn.Conv2d(32, width, 1, bias=False)
        nn.init.zeros_(self.join.weight)  # to begin with, the head says what it said without it

    def forward(self, difference: Tensor) -> Tensor:
        return self.join(self.stem(difference))


class BallHead(nn.Module):
    """Stride-4 map with its detail, and the neck's stride-8 map with its meaning -> heat, place."""

    def __init__(self, *, difference: bool = False) -> None:
        super().__init__()
        self.changed = Changed(32) if difference else None
        self.detail = conv(48, 32, 1)
        self.meaning = conv(FEATURES, 32, 1)
        self.body = nn.Sequential(conv(32, 32), conv(32, 32))
        self.heat = nn.Conv2d(32, 1, 1)
        self.place = nn.Conv2d(32, 4, 1)
        nn.init.constant_(self.heat.bias, -4.6)

    def forward(
        self, x4: Tensor, n8: Tensor, difference: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        x = self.detail(x4) + _double(self.meaning(n8))
        if self.changed is not None:
            x = x + self.changed(difference)
        x = self.body(x)
        return self.heat(x), self.place(x)


class DetectorNet(nn.Module):
    """The whole network; `forward` gives raw outputs, `Exported` decodes them."""

    def __init__(self, *, difference: bool = False) -> None:
        super().__init__()
        self.channels = 4 if difference else 3
        self.backbone = Backbone()
        self.neck = Neck()
        self.heads = nn.ModuleList([PeopleHead(64, 48), PeopleHead(96, 64), PeopleHead(128, 64)])
        self.ball = BallHead()
        self.moving = BallHead(difference=True) if difference else None

    def forward(self, pictures: Tensor) -> Raw:
        """Pictures (B, 3, H, W) RGB 0..1, or (B, 4, H, W) with the difference, -1..1."""
        x4, x8, x16, x32 = self.backbone(pictures[:, :3])
        maps = self.neck(x8, x16, x32)
        scores, boxes = [], []
        for head, x, stride in zip(self.heads, maps, STRIDES, strict=True):
            logits, sides = head(x)
            centres = cell_centres(x.shape[2], x.shape[3], stride, x.device)
            scores.append(logits.flatten(2).transpose(1, 2))
            boxes.append(_from_sides(centres, sides.flatten(2).transpose(1, 2).float(), stride))
        heat, place = self.ball(x4, maps[0])
        moving = None
        if self.moving is not None:
            moved = self.moving(x4, maps[0], pictures[:, 3:])
            moving = (moved[0].float(), moved[1].float())
        return Raw(
            scores=torch.cat(scores, 1).float(),
            boxes=torch.cat(boxes, 1),
            heat=heat.float(),
            ball=place.float(),
            moving=moving,
            features=maps[0],
        )


class Exported(nn.Module):
    """What the ONNX file holds: one picture -> `output` (1, 4 + 3, anchors) and `features`.

    Rows are centre x, y, width, height in input pixels, then the scores of `NAMES`; the ball's
    cells follow the people's anchors, and only peaks of the heat-map keep their score.
    """

    def __init__(self, net: DetectorNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        raw = self.net(images)
        low, high = raw.boxes[..., :2], raw.boxes[..., 2:]
        scores = raw.scores.sigmoid()
        no_ball = torch.zeros_like(scores[..., :1])
        people = torch.cat([(low + high) / 2, high - low, scores, no_ball], 2)
        heat, ball = raw.heat.sigmoid(), raw.ball
        if raw.moving is not None:
            moved = raw.moving[0].sigmoid()
            ball = torch.where(moved > heat, raw.moving[1], ball)
            heat = torch.maximum(heat, moved)
        peak = heat * (heat >= F.max_pool2d(heat, 3, 1, 1)).float()
        centres, sizes = ball_boxes(ball)
        place = torch.cat([centres, sizes], 1).flatten(2)
        nobody = torch.zeros_like(place[:, : len(PEOPLE)])
        ball = torch.cat([place, nobody, peak.flatten(2)], 1).transpose(1, 2)
        return torch.cat([people, ball], 1).transpose(1, 2), raw.features


def cell_centres(height: int, width: int, stride: int, device: torch.device) -> Tensor:
    """Centres of a map's cells row by row: (h * w, 2) x, y in input pixels."""
    y, x = torch.meshgrid(
        torch.arange(height, device=device), torch.arange(width, device=device), indexing="ij"
    )
    return (torch.stack([x, y], 2).reshape(-1, 2) + 0.5) * stride


def ball_boxes(place: Tensor) -> tuple[Tensor, Tensor]:
    """Ball head (B, 4, h, w) -> centres and sizes, each (B, 2, h, w) in input pixels."""
    height, width = place.shape[2:]
    cells = cell_centres(height, width, BALL_STRIDE, place.device).T.reshape(1, 2, height, width)
    # a wild value must not overflow while the weights are young
    sizes = place[:, 2:].clamp(max=4).exp() * BALL_STRIDE
    return cells + place[:, :2] * BALL_STRIDE, sizes


def _from_sides(centres: Tensor, sides: Tensor, stride: int) -> Tensor:
    """Log distances to left, top, right, bottom (B, A, 4) in strides -> xyxy in pixels."""
    distance = sides.clamp(max=5).exp() * stride
    return torch.cat([centres - distance[..., :2], centres + distance[..., 2:]], -1)


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
