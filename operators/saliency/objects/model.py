"""The detector's network: a small context picture in, boxes of objects of one class out.

A context of 109x82 pixels shows a peg of 8x2: places are told on a grid of two pixels, by heat
maps (Zhou et al., "Objects as points", 2019), and features at stride 8 for the policy.
"""

# mypy: disallow-subclassing-any=False
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from operators.training import onnx_files

INPUT_PX = (112, 88)  # width, height: multiples of 8 that hold 109x82
CELL_PX = 2
FEATURES = 64
CONFIDENCE, CLASS, DOMAIN = 0.02, "object", "manipulation"
RARE = -4.0  # bias of the heat map at the start: few cells are centres


class ObjectNet(nn.Module):
    """Heat, offset and size of an object at each cell, and the feature map."""

    def __init__(self) -> None:
        super().__init__()
        self.fine = nn.Sequential(_block(3, 24, size=5, stride=2), _block(24, 32))
        self.middle = nn.Sequential(_block(32, 48, stride=2), _block(48, 48))
        self.coarse = nn.Sequential(_block(48, FEATURES, stride=2), _block(FEATURES, FEATURES))
        self.raise_middle, self.raise_coarse = nn.Conv2d(48, 32, 1), nn.Conv2d(FEATURES, 32, 1)
        self.joined = nn.Sequential(_block(32, 32), _block(32, 32))
        self.head = nn.Conv2d(32, 5, 1)
        nn.init.zeros_(self.head.weight)
        nn.init.constant_(self.head.bias, 0.0)
        self.head.bias.data[0] = RARE

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) RGB 0..1 -> (B, 5, H / 2, W / 2) raw numbers, (B, 64, H / 8, W / 8)."""
        fine = self.fine(images)
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        size = fine.shape[2:]
        for small in (self.raise_middle(middle), self.raise_coarse(coarse)):
            fine = fine + functional.interpolate(small, size, mode="nearest")
        return self.head(self.joined(fine)), coarse


class Exported(nn.Module):
    """What the live operator runs: YOLO's layout, of which only peaks of the heat have a score."""

    def __init__(self, net: ObjectNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(1, 3, H, W) -> (1, 5, cells): centre, size in pixels, score; and the feature map."""
        told, features = self.net(images)
        heat = told[:, :1].sigmoid()
        peak = (functional.max_pool2d(heat, 3, 1, 1) == heat).to(heat)
        boxes = boxes_of(told)
        return torch.cat([boxes, heat * peak], 1).flatten(2), features


def boxes_of(told: Tensor) -> Tensor:
    """Centres and sizes (B, 4, rows, columns) in pixels of the input."""
    rows, columns = told.shape[2:]
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    cells = torch.stack([x, y])[None].to(told)
    centres = (cells + 0.5 + told[:, 1:3]) * CELL_PX
    return torch.cat([centres, told[:, 3:5].clamp(-3, 5).exp()], 1)


def loss_of(told: Tensor, heat: Tensor, boxes: Tensor, weight: Tensor) -> Tensor:
    """Penalty-reduced focal loss of the heat (B, 1, r, c), and L1 of the boxes where weighted.

    `boxes` (B, 4, r, c) are centres and sizes in pixels, `weight` (B, 1, r, c).
    """
    logits = told[:, :1].float()
    chance = logits.sigmoid().clamp(1e-4, 1 - 1e-4)
    centre = (heat > 0.999).float()
    right = -centre * (1 - chance) ** 2 * chance.log()
    wrong = -(1 - centre) * (1 - heat) ** 4 * chance**2 * (1 - chance).log()
    count = centre.sum().clamp(min=1)
    seen = boxes_of(told.float())
    places = (seen[:, :2] - boxes[:, :2]).abs() / CELL_PX
    sizes = (seen[:, 2:].log() - boxes[:, 2:].clamp(min=0.5).log()).abs()
    apart = ((places + sizes) * weight).sum() / weight.sum().clamp(min=1)
    return (right + wrong).sum() / count + apart


def export(net: ObjectNet, path: Path, trained_on: str) -> None:
    """Write the network with what the live operator asks for."""
    width, height = INPUT_PX
    onnx_files.write(
        Exported(net.eval()),
        {"images": torch.zeros(1, 3, height, width)},
        path,
        ("output0", "features"),
        names=str({0: CLASS}),
        task="detect",
        imgsz=str([height, width]),
        stride="8",
        confidence=str({CLASS: CONFIDENCE}),
        domain=DOMAIN,
        trained_on=trained_on,
    )


def _block(given: int, out: int, *, size: int = 3, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(given, out, size, stride, padding=size // 2, bias=False),
        nn.BatchNorm2d(out),
        nn.ReLU(inplace=True),
    )
