"""Train the shipped detector on procedural scenes: `python -m operators.saliency.train --help`.

Renders what is missing, trains on the processor in bfloat16, keeps a running mean of the weights,
writes a checkpoint every two minutes and goes on from it when started again. `--export` writes
the two ONNX files that fovea ships.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import csv
import json
import math
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

from operators.saliency.data import Batch, stream
from operators.saliency.example import INPUT_PX, NAMES, PEOPLE
from operators.saliency.metadata import describe
from operators.saliency.model import (
    BALL_STRIDE,
    STRIDES,
    DetectorNet,
    Encoder,
    Exported,
    Raw,
    ball_boxes,
    cell_centres,
    fused,
)
from operators.saliency.render import render

CHECKPOINT_S = 120.0
CROP_PX = 96
TRAIN_SEEDS = 10_000  # first seed of the training scenes; evaluate.py uses others


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: tuple[Path, ...]
    out: Path
    scenes: int = 400
    moments: int = 24
    span: int = 900  # frames of each scene over which its moments are spread
    steps: int = 8000
    batch: int = 16
    rate: float = 2e-3
    warmup: int = 300
    decay: float = 0.02
    seed: int = 1
    threads: int = 2
    minutes: float = 75.0
    compiled: bool = False


@dataclass(frozen=True, kw_only=True)
class Assigned:
    """What each anchor shall say."""

    quality: Tensor  # (B, A, people) wanted scores, 0 where nobody is
    boxes: Tensor  # (B, A, 4) wanted box, where there is one
    weight: Tensor  # (B, A) its quality
    counts: Tensor  # (B, A) 0 where a hidden person may or may not be found


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
    """
    person = (batch.labels >= 0) & (batch.labels < len(PEOPLE))
    wanted = person & ~batch.ignored
    sides = torch.cat(
        [centres - batch.boxes[:, :, None, :2], batch.boxes[:, :, None, 2:] - centres], -1
    )
    inside = sides.amin(-1) > -reach  # (B, M, A)
    hidden = (inside & (person & batch.ignored)[..., None]).any(1)
    overlap, _ = paired_iou(batch.boxes[:, :, None], raw.boxes[:, None])
    scores = raw.scores.sigmoid().transpose(1, 2)  # (B, people, A)
    row = batch.labels.clamp(0, len(PEOPLE) - 1)[..., None].expand(-1, -1, scores.shape[2])
    metric = scores.gather(1, row).sqrt() * overlap**4 + 1e-9
    metric = metric * (inside & wanted[..., None])
    limit = metric.topk(best, 2).values[..., -1:]
    metric = metric * ((metric >= limit) & (metric > 0))
    # an anchor that several people want goes to the one it overlaps most
    owner = (overlap + 1e-6).mul(metric > 0).argmax(1)  # (B, A)
    mine = F.one_hot(owner, metric.shape[1]).transpose(1, 2) * (metric > 0)
    metric = metric * mine
    scale = (overlap * mine).amax(2, keepdim=True) / metric.amax(2, keepdim=True).clamp(min=1e-9)
    weight = (metric * scale).amax(1)  # (B, A)
    label = batch.labels.clamp(0, len(PEOPLE) - 1).gather(1, owner)
    boxes = batch.boxes.gather(1, owner[..., None].expand(-1, -1, 4))
    quality = F.one_hot(label, len(PEOPLE)) * weight[..., None]
    return Assigned(
        quality=quality, boxes=boxes, weight=weight, counts=(~hidden | (weight > 0)).float()
    )


def people_loss(raw: Raw, batch: Batch, centres: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Class loss and box loss over all anchors."""
    aim = assign(raw, batch, centres, reach)
    total = aim.weight.sum().clamp(min=1.0)
    scores = F.binary_cross_entropy_with_logits(raw.scores, aim.quality, reduction="none")
    chosen = aim.weight > 0
    _, generalised = paired_iou(raw.boxes[chosen], aim.boxes[chosen])
    boxes = ((1 - generalised) * aim.weight[chosen]).sum()
    return (scores.sum(-1) * aim.counts).sum() / total, boxes / total


def ball_loss(raw: Raw, batch: Batch) -> tuple[Tensor, Tensor]:
    """Penalty-reduced focal loss of the heat-map (CenterNet, Eq. 1), and loss of place and size."""
    height, width = raw.heat.shape[2:]
    cells = cell_centres(height, width, BALL_STRIDE, raw.heat.device).reshape(height, width, 2)
    balls = batch.labels == NAMES.index("ball")
    item, row = torch.nonzero(balls & ~batch.ignored, as_tuple=True)
    box = batch.boxes[item, row]
    middle, size = (box[:, :2] + box[:, 2:]) / 2, box[:, 2:] - box[:, :2]
    away = (cells - middle[:, None, None]) / BALL_STRIDE  # (N, h, w, 2), cells
    # about one cell wide for a ball of four pixels, wider for a near one
    spread = (size.amax(1) / BALL_STRIDE * 0.4).clamp(0.7, 3)[:, None, None]
    bump = torch.exp(-away.square().sum(-1) / (2 * spread**2))
    centre = away.abs().amax(-1) <= 0.5
    aim = torch.zeros(len(batch.labels), height, width)
    for place, near, peak in zip(item.tolist(), bump, centre, strict=True):
        aim[place] = torch.maximum(aim[place], torch.where(peak, 1.0, near.clamp(max=0.999)))
    logits = raw.heat[:, 0]
    chance = logits.sigmoid()
    found = (1 - chance) ** 2 * F.logsigmoid(logits) * (aim == 1)
    empty = (1 - aim) ** 4 * chance**2 * F.logsigmoid(-logits) * (aim < 1)
    heat = -(found + empty) * _counted(batch, balls, cells)
    centres, sizes = ball_boxes(raw.ball)
    near = away.abs().amax(-1) <= 1.0  # the neighbours too: the peak may lie one cell off
    which, y, x = torch.nonzero(near, as_tuple=True)
    at = item[which]
    got = torch.cat([centres[at, :, y, x], sizes[at, :, y, x].log()], 1)
    want = torch.cat([middle[which], size[which].clamp(min=1).log()], 1)
    scale = torch.tensor([1 / BALL_STRIDE, 1 / BALL_STRIDE, 1, 1])
    place_loss = F.smooth_l1_loss(got * scale, want * scale, reduction="sum", beta=0.1)
    return heat.sum() / max(len(item), 1), place_loss / max(len(which), 1)


def _counted(batch: Batch, balls: Tensor, cells: Tensor) -> Tensor:
    """(B, h, w): 0 around hidden balls, which may be found or not."""
    item, row = torch.nonzero(balls & batch.ignored, as_tuple=True)
    counted = torch.ones(len(batch.labels), *cells.shape[:2])
    for place, box in zip(item.tolist(), batch.boxes[item, row], strict=True):
        away = torch.maximum(box[:2] - cells, cells - box[2:]).amax(-1)
        counted[place][away < BALL_STRIDE] = 0
    return counted


def losses(net_output: Raw, batch: Batch) -> dict[str, Tensor]:
    """All parts, weighted; their sum is what training lowers."""
    width, height = INPUT_PX
    device = net_output.heat.device
    centres = torch.cat([cell_centres(height // s, width // s, s, device) for s in STRIDES])
    counts = [(height // s) * (width // s) for s in STRIDES]
    reach = torch.cat([torch.full((n,), s * 0.4) for n, s in zip(counts, STRIDES, strict=True)])
    people, boxes = people_loss(net_output, batch, centres, reach)
    heat, place = ball_loss(net_output, batch)
    return {"people": people, "boxes": 2.0 * boxes, "heat": heat, "place": 2.0 * place}


def learning_rate(step: int, settings: TrainSettings) -> float:
    """Linear warm-up, then half a cosine down to a hundredth."""
    if step < settings.warmup:
        return settings.rate * (step + 1) / settings.warmup
    share = min(1.0, (step - settings.warmup) / max(1, settings.steps - settings.warmup))
    return settings.rate * (0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2)


class Run:
    """Everything that a checkpoint holds."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.net = DetectorNet().to(memory_format=torch.channels_last)
        self.mean = DetectorNet()
        self.mean.load_state_dict(self.net.state_dict())
        matrices = [p for p in self.net.parameters() if p.ndim > 1]
        others = [p for p in self.net.parameters() if p.ndim <= 1]
        groups = [
            {"params": matrices, "weight_decay": settings.decay},
            {"params": others, "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.rate, betas=(0.9, 0.99))
        self.step = 0
        self.elapsed_s = 0.0

    @property
    def path(self) -> Path:
        return self.settings.out / "checkpoint.pt"

    def save(self) -> None:
        parts = {"net": self.net, "mean": self.mean, "optimiser": self.optimiser}
        state: dict[str, Any] = {name: part.state_dict() for name, part in parts.items()}
        state |= {"step": self.step, "elapsed_s": self.elapsed_s}
        unfinished = self.path.with_suffix(".part")
        torch.save(state, unfinished)
        unfinished.rename(self.path)

    def resume(self) -> None:
        if not self.path.exists():
            return
        state = torch.load(self.path, weights_only=True)
        self.net.load_state_dict(state["net"])
        self.mean.load_state_dict(state["mean"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.elapsed_s = state["step"], state["elapsed_s"]

    @torch.no_grad()
    def follow(self) -> None:
        """Move the mean weights towards the newest, faster while young."""
        keep = min(0.9993, (1 + self.step) / (10 + self.step))
        new = self.net.state_dict()
        for name, old in self.mean.state_dict().items():
            if old.dtype.is_floating_point:
                old.lerp_(new[name], 1 - keep)
            else:
                old.copy_(new[name])


def train(settings: TrainSettings) -> None:
    """Train until the steps or the minutes are used up; always leaves a checkpoint."""
    torch.set_num_threads(settings.threads)
    settings.out.mkdir(parents=True, exist_ok=True)
    run = Run(settings)
    run.resume()
    run.net.train()
    forward = torch.compile(run.net) if settings.compiled else run.net
    started, saved = time.monotonic() - run.elapsed_s, time.monotonic()
    with (settings.out / "log.csv").open("a", newline="") as file:
        log = csv.writer(file)
        steps = range(run.step, settings.steps)
        batches = stream(settings.data, settings.batch, steps, seed=settings.seed)
        bar = tqdm(batches, initial=run.step, total=settings.steps, mininterval=5)
        for batch in bar:
            parts = _advance(run, forward, batch)
            run.elapsed_s = time.monotonic() - started
            if run.step % 20 == 0:
                figures = [f"{float(v):.4f}" for v in parts.values()]
                log.writerow([run.step, f"{run.elapsed_s:.0f}", *figures])
                file.flush()
                bar.set_postfix_str(
                    " ".join(f"{n} {v}" for n, v in zip(parts, figures, strict=True))
                )
            if time.monotonic() - saved > CHECKPOINT_S:
                run.save()
                saved = time.monotonic()
            if run.elapsed_s > settings.minutes * 60:
                break
    run.save()


def _advance(run: Run, forward: Any, batch: Batch) -> dict[str, Tensor]:
    """One step of the optimiser; returns the parts of the loss."""
    for group in run.optimiser.param_groups:
        group["lr"] = learning_rate(run.step, run.settings)
    pictures = batch.pictures.float().div_(255)
    with torch.autocast("cpu", torch.bfloat16):
        raw = forward(pictures)
    parts = losses(raw, batch)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 10.0)
    run.optimiser.step()
    run.step += 1
    run.follow()
    return {name: part.detach() for name, part in parts.items()}


def export(net: DetectorNet, detector: Path, encoder: Path | None = None) -> None:
    """Write the detector, and its backbone as an encoder of crops, as ONNX."""
    net = fused(net).to(memory_format=torch.contiguous_format)
    width, height = INPUT_PX
    picture, crops = torch.zeros(1, 3, height, width), torch.zeros(2, 3, CROP_PX, CROP_PX)
    _write(Exported(net), picture, detector, ["images"], ["output", "features"])
    facts = {"names": str(dict(enumerate(NAMES))), "stride": "32", "task": "detect"}
    describe(detector, facts | {"format": "yolo"})
    if encoder is not None:
        _write(Encoder(net), crops, encoder, ["crops"], ["features"], open_side="n")


def _write(
    module: torch.nn.Module,
    example: Tensor,
    path: Path,
    inputs: list[str],
    outputs: list[str],
    open_side: str = "",
) -> None:
    axes = {name: {0: open_side} for name in (*inputs, *outputs)} if open_side else None
    with warnings.catch_warnings():
        # the older exporter keeps the parameters' names, by which they can be loaded back
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module.eval(),
            (example,),
            path,
            input_names=inputs,
            output_names=outputs,
            dynamic_axes=axes,
            opset_version=17,
            dynamo=False,
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="rendered scenes")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint and log")
    parser.add_argument("--export", type=Path, help="write the ONNX files here and end")
    parser.add_argument("--compiled", action="store_true", help="compile first: needs g++")
    numbers = {"scenes": 400, "moments": 24, "span": 900, "steps": 8000, "batch": 16}
    numbers |= {"warmup": 300, "seed": 1, "threads": 2}
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    for name, value in {"rate": 2e-3, "decay": 0.02, "minutes": 75.0}.items():
        parser.add_argument(f"--{name}", type=float, default=value)
    given = vars(parser.parse_args())
    target = given.pop("export")
    settings = TrainSettings(**(given | {"data": tuple(given["data"])}))
    if target is not None:
        run = Run(settings)
        run.resume()
        export(run.mean, target / "detector.onnx", target / "roi_encoder.onnx")
        print(json.dumps({"step": run.step, "elapsed_s": run.elapsed_s}))
        return
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + settings.scenes)
    render(seeds, settings.moments, settings.span, settings.data[0], settings.threads)
    train(settings)


if __name__ == "__main__":
    main()
