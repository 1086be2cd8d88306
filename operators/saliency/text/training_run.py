"""Training of the text detector on pictures that fovea draws itself.

It draws missing pictures, trains in mixed precision with a running mean of the weights, and writes
checkpoints at intervals, from which it resumes.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from operators.saliency.initial import from_onnx
from operators.saliency.model import DetectorNet
from operators.saliency.text.data import Batch, Words, collate, stream
from operators.saliency.text.examples import INPUT_PX, draw, drawn, made_of_streets
from operators.saliency.text.losses import losses
from operators.saliency.text.model import Exported, TextNet
from operators.saliency.text.photographs import photographs_in
from operators.saliency.text.roads import made_of_roads, road
from operators.saliency.text.settings import TextTrainSettings
from operators.saliency.text.streets import Picture
from operators.training import checkpoint
from operators.training.averaging import follow, groups
from operators.training.device import device_of, mixed_precision
from operators.training.folder import open_folder
from operators.training.identity import Identity, of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.onnx_files import fused, write
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine

PHASES = Phases("draw streets", "draw drives", "train")
CALIBRATION = 64  # pictures over which an exported network is measured before training goes on
NAME = "text"
TRAINED_ON = "texts in streets that fovea draws itself"
UPON = "half of its boards drawn upon photographs"
BEGUN = "begun with the weights of its other detector"


class Run(checkpoint.Progress):
    """Everything that a checkpoint holds."""

    def __init__(self, settings: TextTrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.device = settings, device_of(settings.device)
        self.net = TextNet().to(self.device, memory_format=torch.channels_last)
        self.mean = TextNet().to(self.device)
        self.mean.load_state_dict(self.net.state_dict())
        self.optimiser = torch.optim.AdamW(
            groups(self.net, settings.decay), lr=settings.rate, betas=(0.9, 0.99)
        )
        parts = {"net": self.net, "mean": self.mean, "optimiser": self.optimiser}
        streets = made_of_streets(photographs_of(settings))
        pictures = {**streets, **(made_of_roads() if settings.clips else {})}
        super().__init__(settings.out, parts, of_settings(settings, "stills") | pictures)

    def begin(self, source: Words) -> None:
        """Take the weights to begin with, unless the training goes on already."""
        init = self.settings.init
        if init is None or self.step:
            return
        if init.suffix == ".onnx":
            self._begin_with(init, collate([source[k] for k in range(CALIBRATION)]))
        else:
            checkpoint.take(init, {"mean": self.mean})
        self.net.load_state_dict(self.mean.state_dict())

    def _begin_with(self, path: Path, batch: Batch) -> None:
        """Take backbone and neck of the shipped detector, measured on these pictures."""
        other = DetectorNet()
        from_onnx(path, other, batch)
        self.mean.backbone.load_state_dict(other.backbone.state_dict())
        self.mean.neck.load_state_dict(other.neck.state_dict())


def photographs_of(settings: TextTrainSettings) -> list[Path]:
    """Return the photographs that boards are drawn upon, none unless asked for."""
    return photographs_in(settings.stills) if settings.stills else []


def source_of(settings: TextTrainSettings) -> Words:
    """Draw what is missing, and return all pictures of a training."""
    stills = photographs_of(settings)
    upon = partial(drawn, stills=stills)
    folders = [_drawn("streets", settings.streets, settings, made_of_streets(stills), upon)]
    if settings.clips:
        folders.append(_drawn("drives", settings.clips, settings, made_of_roads(), road))
    share = settings.clips_share
    return Words(folders, [1 - share, share][: len(folders)], settings.seed)


def _drawn(
    kind: str,
    seeds: int,
    settings: TextTrainSettings,
    made: Identity,
    how: Callable[[int], list[Picture]],
) -> list[Path]:
    """Draw the pictures of one kind that are missing; returns the files of all."""
    folder = settings.data / kind
    draw(range(seeds), folder, made, how, settings.threads, PHASES[f"draw {kind}"])
    return [folder / f"{seed}.npz" for seed in range(seeds)]


def train(settings: TextTrainSettings) -> Run:
    """Draw missing pictures, then train until the limit of steps or minutes."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    run = Run(settings)
    run.resume()  # another training is refused now, and not after the drawing
    source = source_of(settings)
    run.begin(source)
    run.net.train()
    forward = torch.compile(run.net) if settings.compiled else run.net
    started = time.monotonic() - run.elapsed_s
    log = settings.out / "log.csv"
    shorten(log, run.step)
    # a training ended by its limit of minutes is complete: do not change its weights
    over = run.elapsed_s > settings.minutes * 60
    steps = range(run.step, run.step if over else settings.steps)
    with bar(PHASES["train"], settings.steps, run.step) as shown:
        told = ""
        for batch in stream(source, settings.batch, steps, workers=1):
            parts = advance(run, forward, batch)
            run.elapsed_s = time.monotonic() - started
            if run.step % EVERY == 0:
                figures = {name: float(part) for name, part in parts.items()}
                note(log, run.step, run.elapsed_s, figures)
                told = " ".join(f"{n} {v:.4f}" for n, v in figures.items())
            shown.step(told)
            run.save_when_due()
            if run.elapsed_s > settings.minutes * 60:
                break
    run.save()
    return run


def advance(run: Run, forward: Any, batch: Batch) -> dict[str, Tensor]:
    """One step of the optimiser; returns the parts of the loss."""
    s, batch = run.settings, batch.to(run.device)
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(run.step, peak=s.rate, warmup=s.warmup, steps=s.steps)
    with mixed_precision(run.device):
        raw = forward(batch.pictures.float().div_(255))
    parts = losses(raw, batch)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 10.0)
    run.optimiser.step()
    run.step += 1
    follow(run.mean, run.net, run.step)
    return {name: part.detach() for name, part in parts.items()}


def trained_on(settings: TextTrainSettings) -> str:
    """Return what a training has seen, for the file that it writes."""
    upon = [UPON] if settings.stills else []
    begun = [BEGUN] if settings.init else []
    return "; ".join([TRAINED_ON, *upon, *begun])


def export(net: TextNet, path: Path, seen: str = TRAINED_ON) -> None:
    """Write the detector as ONNX; its input may have any sides that are multiples of 32."""
    net = fused(net).to(memory_format=torch.contiguous_format)
    width, height = INPUT_PX
    write(
        Exported(net),
        {"images": torch.zeros(1, 3, height, width)},
        path,
        ("output", "features"),
        open_sides={
            "images": {2: "height", 3: "width"},
            "output": {2: "anchors"},
            "features": {2: "rows", 3: "columns"},
        },
        imgsz=str([height, width]),
        names=str({0: NAME}),
        stride="32",
        task="obb",
        format="yolo",
        trained_on=seen,
    )
