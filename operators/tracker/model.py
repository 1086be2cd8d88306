"""The template tracker's network: template, its shape and search picture -> maps and a score.

One small trunk sees both pictures. Each cell of the template is compared with each cell of the
search picture by cosine (a pixel-wise correlation, Yan et al. 2021, "Alpha-Refine", section 3.2);
the head sees these likenesses beside what the search picture shows.
"""

# mypy: disallow-subclassing-any=False
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from operators.tracker.template import CELLS, TEMPLATE_PX

STRIDE = 8
TEMPLATE_CELLS = TEMPLATE_PX // STRIDE
WIDTHS = (16, 32, 80)  # channels at strides 2, 4, 8
COMPARED = 64  # channels by which cells are compared
HEAD = 80


def convolution(
    inputs: int, outputs: int, kernel: int, stride: int = 1, act: bool = True
) -> nn.Sequential:
    """Convolution, batch norm and, if asked for, an activation.

    Dense ones of few channels: on a processor, depthwise ones took three times as long to train.
    """
    parts: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*parts, *([nn.ReLU(inplace=True)] if act else []))


class Residual(nn.Module):
    """A convolution that is added to its input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.block = convolution(width, width, 3, act=False)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.block(x))


class TemplateNet(nn.Module):
    """The trunk, the comparison and the head."""

    def __init__(self) -> None:
        super().__init__()
        first, second, third = WIDTHS
        self.trunk = nn.Sequential(
            convolution(3, first, 3, 2),
            convolution(first, second, 3, 2),
            convolution(second, third, 3, 2),
            *(Residual(third) for _ in range(3)),
        )
        self.compared = nn.Conv2d(third, COMPARED, 1)
        self.sharpness = nn.Parameter(torch.tensor(4.0))
        self.enter = convolution(TEMPLATE_CELLS**2 + third + 2, HEAD, 1)
        self.head = nn.Sequential(*(Residual(HEAD) for _ in range(4)))
        self.maps = nn.Conv2d(HEAD, 5, 1)  # heat, log width, log height, offset x, y
        self.there = nn.Linear(2 * HEAD, 1)
        nn.init.constant_(self.maps.bias[:1], -4.0)  # one cell in many holds the object

    def forward(self, template: Tensor, shape: Tensor, search: Tensor) -> tuple[Tensor, ...]:
        """Logits, as training needs them.

        template (n, 3, 64, 64) and search (n, 3, 128, 128), normalised; shape (n, 2), log of width
        and height over the root of the area -> maps (n, 5, 16, 16), presence (n, 1).
        """
        old = F.normalize(self.compared(self.trunk(template)).flatten(2), dim=1)
        seen = self.trunk(search)
        new = F.normalize(self.compared(seen).flatten(2), dim=1)
        likeness = (old.transpose(1, 2) @ new).unflatten(2, (CELLS, CELLS)) * self.sharpness
        told = shape[:, :, None, None].expand(-1, -1, CELLS, CELLS)
        x = self.head(self.enter(torch.cat([likeness, seen, told], 1)))
        pooled = torch.cat([x.amax((2, 3)), x.mean((2, 3))], 1)
        return self.maps(x), self.there(pooled)


class Deployed(nn.Module):
    """What runs live: heat 0..1, sizes in looks, offsets in cells, score 0..1."""

    def __init__(self, net: TemplateNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, template: Tensor, shape: Tensor, search: Tensor) -> tuple[Tensor, ...]:
        """Inputs as `TemplateNet` -> (1, 1, 16, 16), (1, 2, 16, 16) twice, (1, 1)."""
        maps, there = self.net(template, shape, search)
        sizes = maps[:, 1:3].clamp(-3, 3).exp() / 4  # the object at rest is a quarter of a look
        return maps[:, :1].sigmoid(), sizes, maps[:, 3:], there.sigmoid()
