"""Losses of the text detector's training: raw outputs and words -> losses.

Task-aligned assignment (Feng et al., TOOD 2021) among the anchors in the middle of each word;
overlap of turned boxes as of Gaussians (Llerena et al. 2021), which is smooth in the angle.
"""

# mypy: disallow-untyped-decorators=False
import torch
from torch import Tensor
from torch.nn import functional as F

from operators.saliency.text.data import Batch
from operators.saliency.text.model import Raw

BEST = 7  # anchors that learn one word
LEAST_WEIGHT = 0.1  # of a chosen anchor in the loss of boxes, while the overlap is small


def overlap(a: Tensor, b: Tensor) -> Tensor:
    """Likeness 0..1 of turned boxes (..., 5) row by row: 1 less Hellinger distance of Gaussians."""
    xx, yy, xy = (one + other for one, other in zip(_spread(a), _spread(b), strict=True))
    det = (xx * yy - xy.square()).clamp(min=1e-9)
    dx, dy = (a[..., :2] - b[..., :2]).unbind(-1)
    apart = (yy * dx.square() + xx * dy.square() - 2 * xy * dx * dy) / det / 4
    sizes = (a[..., 2] * a[..., 3] * b[..., 2] * b[..., 3]).clamp(min=1e-9) / 144
    shape = 0.5 * (det / (4 * sizes)).clamp(min=1).log()
    distance = (apart + shape).clamp(1e-6, 80)
    return 1 - (1 - (-distance).exp()).clamp(min=1e-7).sqrt()


def _spread(boxes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Variances x, y and covariance of the Gaussian of each box (..., 5)."""
    long, high = boxes[..., 2].square() / 12, boxes[..., 3].square() / 12
    sine, cosine = boxes[..., 4].sin(), boxes[..., 4].cos()
    xx = long * cosine.square() + high * sine.square()
    yy = long * sine.square() + high * cosine.square()
    return xx, yy, (long - high) * sine * cosine


def losses(raw: Raw, batch: Batch) -> dict[str, Tensor]:
    """All parts, weighted; their sum is what training lowers."""
    count = raw.scores.shape[1]
    there = batch.candidates >= 0  # (G, MOST)
    place = batch.candidates.clamp(min=0) + batch.item[:, None] * count  # in all anchors
    wanted = batch.boxes[:, None].expand(-1, place.shape[1], -1)
    found = raw.boxes.reshape(-1, 5)[place]
    likeness = overlap(found, wanted)
    weight = _weights(
        likeness.detach(), raw.scores.detach().flatten()[place].sigmoid(), there, place
    )
    chosen = weight > 0
    total = weight.sum().clamp(min=1.0)
    quality = torch.zeros(raw.scores.numel(), device=weight.device)
    quality.scatter_reduce_(0, place[chosen], weight[chosen], "amax")
    counts = batch.counts.flatten().float().clone()
    counts[place[chosen]] = 1
    scores = F.binary_cross_entropy_with_logits(raw.scores.flatten(), quality, reduction="none")
    weighty = weight[chosen].clamp(min=LEAST_WEIGHT)
    turn = 1 - (2 * (found[..., 4] - wanted[..., 4])[chosen]).cos()
    return {
        "text": (scores * counts).sum() / total,
        "boxes": 2.0 * ((1 - likeness[chosen]) * weighty).sum() / total,
        "turn": (turn * weighty).sum() / total,
    }


@torch.no_grad()
def _weights(likeness: Tensor, score: Tensor, there: Tensor, place: Tensor) -> Tensor:
    """Wanted score of each candidate (G, MOST), 0 where another one or another word is better."""
    metric = (score.sqrt() * likeness**3 + 1e-9) * there
    limit = metric.topk(BEST, 1).values[:, -1:]
    metric = metric * (metric >= limit)
    if not len(metric):
        return metric
    # an anchor that several words want goes to the one it overlaps most
    rank = likeness * (metric > 0)
    best = torch.zeros(int(place.max()) + 1, device=rank.device)
    best.scatter_reduce_(0, place.flatten(), rank.flatten(), "amax")
    metric = metric * (rank >= best[place])
    likeness = likeness * (metric > 0)
    most = metric.amax(1, keepdim=True).clamp(min=1e-9)
    return metric / most * likeness.amax(1, keepdim=True)
