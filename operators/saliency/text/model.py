"""The network that finds words: pictures (B, 3, H, W) -> one turned box per cell of 4x2 pixels.

Backbone and neck are the shipped detector's (`operators.saliency.model`); the head reads their
maps at strides 4 and 8. In a context a word is two to ten pixels high and lines follow one another
closely, so each cell of 4x4 pixels has an upper and a lower anchor.
"""

# mypy: disallow-subclassing-any=False
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from operators.saliency.model import FEATURES, Backbone, Neck, conv
from operators.saliency.text.anchors import ANCHOR_PX

STRIDE = 4
WIDTH = 48  # channels of the head
VALUES = 6  # of an anchor: score, offset x, y, log length, log height, angle


@dataclass(frozen=True, kw_only=True)
class Raw:
    """Outputs before decoding; A anchors row by row, as `anchors.centres` has them."""

    scores: Tensor  # (B, A) logits
    boxes: Tensor  # (B, A, 5) centre x, y, length, height in input pixels, angle in radians
    features: Tensor  # (B, FEATURES, H/8, W/8)


class TextHead(nn.Module):
    """The backbone's stride-4 map and the neck's stride-8 map -> VALUES of each anchor."""

    def __init__(self) -> None:
        super().__init__()
        self.detail = conv(48, WIDTH, 1)
        self.meaning = conv(FEATURES, WIDTH, 1)
        self.body = nn.Sequential(conv(WIDTH, WIDTH), conv(WIDTH, WIDTH))
        self.values = nn.Conv2d(WIDTH, 2 * VALUES, 1)
        with torch.no_grad():
            # few anchors hold a word: start by believing so, or the first steps only unlearn
            self.values.bias.view(2, VALUES)[:] = torch.tensor([-4.0, 0, 0, 1.0, 0, 0])

    def forward(self, x4: Tensor, n8: Tensor) -> Tensor:
        """Return (B, A, VALUES)."""
        coarse = F.interpolate(self.meaning(n8), scale_factor=2.0, mode="nearest")
        values = self.values(self.body(self.detail(x4) + coarse))
        rows, columns = values.shape[2], values.shape[3]
        split = values.reshape(-1, 2, VALUES, rows, columns)
        return split.permute(0, 3, 1, 4, 2).reshape(-1, 2 * rows * columns, VALUES)


class TextNet(nn.Module):
    """The whole network; `forward` gives raw outputs, `Exported` decodes them."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.neck = Neck()
        self.head = TextHead()

    def forward(self, pictures: Tensor) -> Raw:
        """Pictures (B, 3, H, W) RGB 0..1."""
        x4, x8, x16, x32 = self.backbone(pictures)
        n8, _, _ = self.neck(x8, x16, x32)
        values = self.head(x4, n8).float()
        centres = centres_of(x4.shape[2], x4.shape[3], x4.device)
        return Raw(scores=values[..., 0], boxes=_decoded(values, centres), features=n8)


class Exported(nn.Module):
    """What the ONNX file holds: one picture -> `output` (1, 4 + 1 + 1, anchors) and `features`.

    Rows are centre x, y, length, height in input pixels, the score of `text` and the angle. Only
    peaks keep their score: suppression would have to compare hundreds of turned boxes.
    """

    def __init__(self, net: TextNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        raw = self.net(images)
        scores = raw.scores.sigmoid()
        map_ = scores.reshape(-1, 1, images.shape[2] // 2, images.shape[3] // 4)
        peak = (map_ >= F.max_pool2d(map_, 3, 1, 1)).float().reshape(scores.shape)
        rows = [raw.boxes[..., :4], (scores * peak)[..., None], raw.boxes[..., 4:]]
        return torch.cat(rows, 2).transpose(1, 2), raw.features


def centres_of(rows: int, columns: int, device: torch.device) -> Tensor:
    """Centres of the anchors of a stride-4 map row by row: (A, 2) x, y in input pixels."""
    y, x = torch.meshgrid(
        torch.arange(2 * rows, device=device), torch.arange(columns, device=device), indexing="ij"
    )
    middles = [(x + 0.5) * ANCHOR_PX[0], (y + 0.5) * ANCHOR_PX[1]]
    return torch.stack(middles, 2).reshape(-1, 2)


def _decoded(values: Tensor, centres: Tensor) -> Tensor:
    """Values of anchors (B, A, VALUES) -> turned boxes (B, A, 5)."""
    middle = centres + values[..., 1:3] * STRIDE
    # a wild value must not overflow while the weights are young
    sizes = values[..., 3:5].clamp(-3, 5).exp() * STRIDE
    angle = (values[..., 5:].sigmoid() - 0.5) * torch.pi
    return torch.cat([middle, sizes, angle], -1)
