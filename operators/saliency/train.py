"""Train the shipped detector on procedural scenes: `python -m operators.saliency.train --help`.

Renders what is missing, trains in bfloat16, keeps a running mean of the weights,
writes a checkpoint every two minutes and goes on from it when started again. `--export` writes
the ONNX file that fovea ships.
"""

# mypy: disallow-untyped-decorators=False
import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from operators.saliency.data import Batch, stream
from operators.saliency.example import INPUT_PX, NAMES
from operators.saliency.losses import losses
from operators.saliency.model import DetectorNet, Exported
from operators.saliency.render import render
from operators.training import checkpoint
from operators.training.device import DEVICES, device_of
from operators.training.log import EVERY, note, shorten
from operators.training.onnx_files import fused, write
from operators.training.schedule import warmed_cosine
from pipeline.errors import FoveaError

CHECKPOINT_S = 120.0
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
    init: Path | None = None  # a checkpoint to begin with instead of random weights
    device: str = "auto"  # where the network is; scenes are drawn on processors

    def __post_init__(self) -> None:
        device_of(self.device)  # refused now, and not after the drawing


class Run(checkpoint.Progress):
    """Everything that a checkpoint holds."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.device = settings, device_of(settings.device)
        self.net = DetectorNet().to(self.device, memory_format=torch.channels_last)
        self.mean = DetectorNet().to(self.device)
        self.mean.load_state_dict(self.net.state_dict())
        matrices = [p for p in self.net.parameters() if p.ndim > 1]
        others = [p for p in self.net.parameters() if p.ndim <= 1]
        groups = [
            {"params": matrices, "weight_decay": settings.decay},
            {"params": others, "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.rate, betas=(0.9, 0.99))
        parts = {"net": self.net, "mean": self.mean, "optimiser": self.optimiser}
        super().__init__(settings.out, parts)
        if settings.init is not None:
            state = checkpoint.read(settings.init)
            self.net.load_state_dict(state["mean"])
            self.mean.load_state_dict(state["mean"])

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
    log = settings.out / "log.csv"
    shorten(log, run.step)
    steps = range(run.step, settings.steps)
    # beside a GPU the processors have nothing else to do
    workers = 1 if run.device.type == "cpu" else settings.threads
    batches = stream(settings.data, settings.batch, steps, seed=settings.seed, workers=workers)
    bar = tqdm(batches, initial=run.step, total=settings.steps, mininterval=5)
    for batch in bar:
        parts = advance(run, forward, batch)
        run.elapsed_s = time.monotonic() - started
        if run.step % EVERY == 0:
            figures = {name: float(part) for name, part in parts.items()}
            note(log, run.step, run.elapsed_s, figures)
            bar.set_postfix_str(" ".join(f"{n} {v:.4f}" for n, v in figures.items()))
        if time.monotonic() - saved > CHECKPOINT_S:
            run.save()
            saved = time.monotonic()
        if run.elapsed_s > settings.minutes * 60:
            break
    run.save()


def advance(run: Run, forward: Any, batch: Batch) -> dict[str, Tensor]:
    """One step of the optimiser; returns the parts of the loss."""
    s, batch = run.settings, batch.to(run.device)
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(run.step, peak=s.rate, warmup=s.warmup, steps=s.steps)
    pictures = batch.pictures.float().div_(255)
    with torch.autocast(run.device.type, torch.bfloat16):
        raw = forward(pictures)
    parts = losses(raw, batch)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 10.0)
    run.optimiser.step()
    run.step += 1
    run.follow()
    return {name: part.detach() for name, part in parts.items()}


def export(net: DetectorNet, path: Path) -> None:
    """Write the detector as ONNX."""
    net = fused(net).to(memory_format=torch.contiguous_format)
    width, height = INPUT_PX
    write(
        Exported(net),
        {"images": torch.zeros(1, 3, height, width)},
        path,
        ("output", "features"),
        names=str(dict(enumerate(NAMES))),
        stride="32",
        task="detect",
        format="yolo",
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="rendered scenes")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint and log")
    parser.add_argument("--export", type=Path, help="write detector.onnx here, train nothing")
    parser.add_argument("--init", type=Path, help="checkpoint whose weights to begin with")
    parser.add_argument("--compiled", action="store_true", help="compile first: needs g++")
    parser.add_argument("--device", default="auto", help=DEVICES)
    numbers = {"scenes": 320, "moments": 12, "span": 900, "steps": 4800, "batch": 16}
    numbers |= {"warmup": 300, "seed": 1, "threads": 2}
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    for name, value in {"rate": 2e-3, "decay": 0.02, "minutes": 120.0}.items():
        parser.add_argument(f"--{name}", type=float, default=value)
    given = vars(parser.parse_args())
    target = given.pop("export")
    try:
        settings = TrainSettings(**(given | {"data": tuple(given["data"])}))
    except FoveaError as error:
        parser.error(str(error))
    if target is None:
        seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + settings.scenes)
        render(seeds, settings.moments, settings.span, settings.data[0], settings.threads)
        train(settings)
    run = Run(settings)
    run.resume()
    export(run.mean, (target or settings.out) / "detector.onnx")
    print(json.dumps({"step": run.step, "elapsed_s": run.elapsed_s}))


if __name__ == "__main__":
    main()
