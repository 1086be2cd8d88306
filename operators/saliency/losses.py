"""Losses of the detector's training: raw outputs and ground truth -> losses.

People are detected at three strides by task-aligned assignment, the ball by a heat-map at stride 4;
of a network that reads what changed, a ball that moved by another one.
"""

# mypy: disallow-untyped-decorators=False
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from operators.saliency.data import Batch
from operators.saliency.example import ANYONE, NAMES, PEOPLE
from operators.saliency.model import BALL_STRIDE, STRIDES, Raw, ball_boxes, cell_centres

# of 255; the noise of two smoothed pictures stays below. Where a training misjudges the camera's
# movement, a still ball's edges reach it, too: such a ball is then wanted as one that moved
MOVED_LEVELS = 10.0


@dataclass(frozen=True, kw_only=True)
class Assigned:
    """The training target of each anchor."""

    quality: Tensor  # (B, A, people) wanted scores, 0 where nobody is
    boxes: Tensor  # (B, A, 4) wanted box, where there is one
    weight: Tensor  # (B, A) its quality
    counts: Tensor  # (B, A, people) 0 where a hidden person, or one of this class, may be found


def paired_iou(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """IoU and generalised IoU (Rezatofighi et al. 2019) of boxes (..., 4) row by row."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    common = (high - low).clamp(min=0).prod(-1)
    union = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1) - common
    around = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    overlap = common / union.clamp(min=1e-6)
    hull = around.prod(-1).clamp(min=1e-6)
    return overlap, overlap - (hull - union) / hull


@torch.no_grad()
def assign(raw: Raw, batch: Batch, centres: Tensor, reach: Tensor, best: int = 9) -> Assigned:
    """Task-aligned assignment (Feng et al., TOOD 2021): the anchors that already do best learn.

    `centres` (A, 2) and `reach` (A,), how far outside a box its anchors may lie, in input pixels.
    Where it is not known which person it is, the likelier class is wanted and no other counts.
    """
    anyone = batch.labels == ANYONE
    person = ((batch.labels >= 0) & (batch.labels < len(PEOPLE))) | anyone
    wanted = person & ~batch.ignored
    sides = torch.cat(
        [centres - batch.boxes[:, :, None, :2], batch.boxes[:, :, None, 2:] - centres], -1
    )
    inside = sides.amin(-1) > -reach  # (B, M, A)
    hidden = (inside & (person & batch.ignored)[..., None]).any(1)
    overlap, _ = paired_iou(batch.boxes[:, :, None], raw.boxes[:, None])
    scores = raw.scores.sigmoid().transpose(1, 2)  # (B, people, A)
    row = batch.labels.clamp(0, len(PEOPLE) - 1)[..., None].expand(-1, -1, scores.shape[2])
    score = torch.where(anyone[..., None], scores.amax(1, keepdim=True), scores.gather(1, row))
    metric = score.sqrt() * overlap**4 + 1e-9
    metric = metric * (inside & wanted[..., None])
    limit = metric.topk(best, 2).values[..., -1:]
    metric = metric * ((metric >= limit) & (metric > 0))
    # an anchor that several people want goes to the one it overlaps most
    owner = (overlap + 1e-6).mul(metric > 0).argmax(1)  # (B, A)
    mine = F.one_hot(owner, metric.shape[1]).transpose(1, 2) * (metric > 0)
    metric = metric * mine
    scale = (overlap * mine).amax(2, keepdim=True) / metric.amax(2, keepdim=True).clamp(min=1e-9)
    weight = (metric * scale).amax(1)  # (B, A)
    unsure = anyone.gather(1, owner) & (weight > 0)  # (B, A)
    label = batch.labels.clamp(0, len(PEOPLE) - 1).gather(1, owner)
    label = torch.where(unsure, scores.argmax(1), label)
    boxes = batch.boxes.gather(1, owner[..., None].expand(-1, -1, 4))
    classes = F.one_hot(label, len(PEOPLE))
    seen = (~hidden | (weight > 0))[..., None] & (~unsure[..., None] | (classes > 0))
    return Assigned(
        quality=classes * weight[..., None], boxes=boxes, weight=weight, counts=seen.float()
    )


def people_loss(raw: Raw, batch: Batch, centres: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Class loss and box loss over all anchors."""
    aim = assign(raw, batch, centres, reach)
    total = aim.weight.sum().clamp(min=1.0)
    scores = F.binary_cross_entropy_with_logits(raw.scores, aim.quality, reduction="none")
    chosen = aim.weight > 0
    _, generalised = paired_iou(raw.boxes[chosen], aim.boxes[chosen])
    boxes = ((1 - generalised) * aim.weight[chosen]).sum()
    return (scores * aim.counts).sum() / total, boxes / total


def ball_loss(
    heat_map: Tensor, place: Tensor, batch: Batch, wanted: Tensor
) -> tuple[Tensor, Tensor]:
    """Penalty-reduced focal loss of the heat-map (CenterNet, Eq. 1), and loss of place and size.

    `wanted` (B, M): the balls to find; others may be found or not.
    """
    height, width = heat_map.shape[2:]
    cells = cell_centres(height, width, BALL_STRIDE, heat_map.device).reshape(height, width, 2)
    item, row = torch.nonzero(wanted, as_tuple=True)
    box = batch.boxes[item, row]
    middle, size = (box[:, :2] + box[:, 2:]) / 2, box[:, 2:] - box[:, :2]
    away = (cells - middle[:, None, None]) / BALL_STRIDE  # (N, h, w, 2), cells
    # about one cell wide for a ball of four pixels, wider for a near one
    spread = (size.amax(1) / BALL_STRIDE * 0.4).clamp(0.7, 3)[:, None, None]
    bump = torch.exp(-away.square().sum(-1) / (2 * spread**2))
    centre = away.abs().amax(-1) <= 0.5
    aim = torch.zeros(len(batch.labels), height, width, device=cells.device)
    for picture, near, peak in zip(item.tolist(), bump, centre, strict=True):
        aim[picture] = torch.maximum(aim[picture], torch.where(peak, 1.0, near.clamp(max=0.999)))
    logits = heat_map[:, 0]
    chance = logits.sigmoid()
    found = (1 - chance) ** 2 * F.logsigmoid(logits) * (aim == 1)
    empty = (1 - aim) ** 4 * chance**2 * F.logsigmoid(-logits) * (aim < 1)
    heat = -(found + empty) * _counted(batch, balls_of(batch) & ~wanted, cells)
    centres, sizes = ball_boxes(place)
    near = away.abs().amax(-1) <= 1.0  # the neighbours too: the peak may lie one cell off
    which, y, x = torch.nonzero(near, as_tuple=True)
    at = item[which]
    got = torch.cat([centres[at, :, y, x], sizes[at, :, y, x].log()], 1)
    want = torch.cat([middle[which], size[which].clamp(min=1).log()], 1)
    scale = torch.tensor([1 / BALL_STRIDE, 1 / BALL_STRIDE, 1, 1]).to(cells.device)
    place_loss = F.smooth_l1_loss(got * scale, want * scale, reduction="sum", beta=0.1)
    return heat.sum() / max(len(item), 1), place_loss / max(len(which), 1)


def balls_of(batch: Batch) -> Tensor:
    """(B, M): which objects are balls."""
    return batch.labels == NAMES.index("ball")


def has_moved(batch: Batch) -> Tensor:
    """(B, M): the middle of which objects changed more than noise does since the frame before."""
    smooth = F.avg_pool2d(batch.difference.float() * 2, 3, 1, 1).abs()  # levels
    most = F.max_pool2d(smooth, 5, 1, 2)[:, 0]
    height, width = most.shape[1:]
    middle = ((batch.boxes[..., :2] + batch.boxes[..., 2:]) / 2).long()
    x, y = middle[..., 0].clamp(0, width - 1), middle[..., 1].clamp(0, height - 1)
    items = torch.arange(len(most), device=most.device)[:, None]
    return most[items, y, x] >= MOVED_LEVELS


def _counted(batch: Batch, others: Tensor, cells: Tensor) -> Tensor:
    """(B, h, w): 0 around other balls, which may be found or not."""
    item, row = torch.nonzero(others, as_tuple=True)
    counted = torch.ones(len(batch.labels), *cells.shape[:2], device=cells.device)
    for place, box in zip(item.tolist(), batch.boxes[item, row], strict=True):
        away = torch.maximum(box[:2] - cells, cells - box[2:]).amax(-1)
        counted[place][away < BALL_STRIDE] = 0
    return counted


def losses(raw: Raw, batch: Batch, only: str = "") -> dict[str, Tensor]:
    """All parts, weighted; their sum is what training lowers. `only`: those of one of `HEADS`."""
    parts: dict[str, Tensor] = {}
    balls = balls_of(batch) & ~batch.ignored
    if not only:
        height, width = (side * BALL_STRIDE for side in raw.heat.shape[2:])
        device = raw.heat.device
        centres = torch.cat([cell_centres(height // s, width // s, s, device) for s in STRIDES])
        counts = [(height // s) * (width // s) for s in STRIDES]
        reach = torch.cat(
            [torch.full((n,), s * 0.4, device=device) for n, s in zip(counts, STRIDES, strict=True)]
        )
        people, boxes = people_loss(raw, batch, centres, reach)
        parts |= {"people": people, "boxes": 2.0 * boxes}
    if only != "moving":
        heat, place = ball_loss(raw.heat, raw.ball, batch, balls)
        parts |= {"heat": heat, "place": 2.0 * place}
    if raw.moving is not None and only != "ball":
        heat, place = ball_loss(*raw.moving, batch, balls & has_moved(batch))
        parts |= {"moving heat": heat, "moving place": 2.0 * place}
    return parts
