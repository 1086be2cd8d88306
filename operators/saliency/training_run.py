"""Training of the shipped detector on procedural scenes and labelled stills.

It renders missing scenes, trains in mixed precision with a running mean of the weights, and writes
checkpoints at intervals, from which it resumes. `--export` writes the ONNX file that fovea ships.
"""

import time
from collections.abc import Sequence
from hashlib import sha256
from itertools import count, islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from operators.saliency.data import Batch, Mixed, Real, Rendered, collate, rendered_in, stream
from operators.saliency.description import DIFFERENCE
from operators.saliency.example import DOMAIN, INPUT_PX, NAMES, Example, sides_of
from operators.saliency.initial import from_onnx
from operators.saliency.losses import losses
from operators.saliency.model import DetectorNet, Exported
from operators.saliency.render import made_with, render
from operators.saliency.stills import Stills, stills
from operators.saliency.training_settings import TrainSettings
from operators.training import checkpoint
from operators.training.averaging import follow, groups
from operators.training.device import device_of, mixed_precision
from operators.training.folder import open_folder
from operators.training.identity import of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.onnx_files import fused, write
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine
from operators.training.splits import HELD_OUT
from operators.training.stills import contents as contents_of_stills
from pipeline.fleet.placement import file_digest

PHASES = Phases("draw scenes", "train")
# pictures of `width_px` over which an exported network is measured before training goes on
CALIBRATION = 64
TRAIN_SEEDS = 10_000  # first seed of the training scenes; evaluate.py uses others


class Run(checkpoint.Progress):
    """Everything that a checkpoint holds."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.device = settings, device_of(settings.device)
        self.net = network(settings).to(self.device, memory_format=torch.channels_last)
        self.mean = network(settings).to(self.device)
        self.mean.load_state_dict(self.net.state_dict())
        self.optimiser = torch.optim.AdamW(
            groups(learning(self.net, settings.only), settings.decay),
            lr=settings.rate,
            betas=(0.9, 0.99),
        )
        parts = {"net": self.net, "mean": self.mean, "optimiser": self.optimiser}
        real = [file for folder in folders(settings) for file in folder.files]
        pictures = made_with(settings.moments, settings.span, settings.rois) | {
            "data": contents(given(settings)), "stills": contents_of_stills(real),
        }  # fmt: skip
        super().__init__(settings.out, parts, of_settings(settings, "stills") | pictures)

    def begin(self, source: Dataset[Example]) -> None:
        """Take the weights to begin with, unless the training goes on already."""
        init = self.settings.init
        if init is None or self.step:
            return
        if init.suffix == ".onnx":
            widths, size = len(self.settings.widths_px), self.settings.batch
            numbers = (k for k in count() if k // size % widths == 0)
            batch = collate([source[k] for k in islice(numbers, CALIBRATION)])
            from_onnx(init, self.mean, batch.to(self.device))
        else:
            checkpoint.take(init, {"mean": self.mean})
        self.net.load_state_dict(self.mean.state_dict())


def network(settings: TrainSettings) -> DetectorNet:
    """The network of a training, with random weights."""
    return DetectorNet(difference=settings.difference)


def learning(net: DetectorNet, only: str = "") -> nn.Module:
    """The part that learns: the network, one of its heads, or both of those for a ball."""
    if only == "balls":
        return nn.ModuleDict({name: net.get_submodule(name) for name in ("ball", "moving")})
    return net.get_submodule(only) if only else net


def learn(net: DetectorNet, only: str = "") -> None:
    """Let a network learn, or a part of it alone: the rest, norms too, stays as it is."""
    net.eval().requires_grad_(False)
    learning(net, only).train().requires_grad_(True)


def drawn(settings: TrainSettings) -> list[Path]:
    """Return the files of scenes rendered for this training, ignoring others in the folder."""
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + settings.scenes)
    return [settings.data[0] / f"{seed}.npz" for seed in seeds]


def given(settings: TrainSettings) -> list[Path]:
    """Return the files of given folders; a folder named twice counts twice."""
    folders = settings.data[1:] if settings.scenes else settings.data
    return [path for folder in folders for path in rendered_in(folder)]


def folders(settings: TrainSettings) -> list[Stills]:
    """Return the stills to train on; raises `DriverError` as `stills` does."""
    return [stills(folder, without=settings.leave_out) for folder in settings.stills]


def source_of(settings: TrainSettings) -> Mixed:
    """Return all pictures of a training; scenes must be drawn before."""
    files, real = [*drawn(settings), *given(settings)], folders(settings)
    for folder in real:
        for file in folder.files:
            folder.rows(file)  # a malformed text is refused now, and not in the midst of training
    seed, roi_share, difference = settings.seed, settings.roi_share, settings.difference
    return Mixed(
        Rendered(files, seed=seed, raw_share=settings.raw_share) if files else None,
        Real(real, seed=seed, roi_share=roi_share, difference=difference) if real else None,
        settings.stills_share,
        seed,
        widths_px=settings.widths_px,
        batch=settings.batch,
    )


def contents(files: Sequence[Path]) -> str:
    """What is in files, and how often."""
    known = {path: file_digest(path) + file_digest(path.with_suffix(".npy")) for path in set(files)}
    whole = sha256("".join(known[path] for path in files).encode()).hexdigest()
    return f"{len(files)} files, {whole[:16]}" if files else "as drawn"


def train(settings: TrainSettings) -> Run:
    """Render missing scenes, then train until the limit of steps or minutes."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    run = Run(settings)
    run.resume()  # another training is refused now, and not after the drawing
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + settings.scenes)
    render(
        seeds, settings.moments, settings.span, settings.data[0], settings.threads,
        PHASES["draw scenes"], settings.rois,
    )  # fmt: skip
    source = source_of(settings)
    run.begin(source)
    learn(run.net, settings.only)
    forward = torch.compile(run.net) if settings.compiled else run.net
    started = time.monotonic() - run.elapsed_s
    log = settings.out / "log.csv"
    shorten(log, run.step)
    # a training ended by its limit of minutes is complete: do not change its weights
    over = run.elapsed_s > settings.minutes * 60
    steps = range(run.step, run.step if over else settings.steps)
    # with a GPU, all CPU cores are available for the loader
    workers = 1 if run.device.type == "cpu" else settings.threads
    batches = stream(source, settings.batch, steps, workers=workers)
    with bar(PHASES["train"], settings.steps, run.step) as shown:
        told = ""
        for batch in batches:
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
        raw = forward(batch.inputs(run.net.channels))
    parts = losses(raw, batch, s.only)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 10.0)
    run.optimiser.step()
    run.step += 1
    follow(run.mean, run.net, run.step)
    return {name: part.detach() for name, part in parts.items()}


def trained_on(settings: TrainSettings) -> str:
    """Return what a training has seen, for the file that it writes."""
    if not settings.stills:
        return "soccer matches: scenes that fovea draws itself"
    names = " and ".join(folder.resolve().name for folder in settings.stills)
    given = ", ".join(settings.leave_out) or "nothing"
    without = "" if settings.leave_out == HELD_OUT else f", {given} left out"
    return f"soccer matches: scenes that fovea draws itself, labelled stills ({names}){without}"


def export(
    net: DetectorNet, path: Path, seen: str = "soccer matches", width_px: int = INPUT_PX[0]
) -> None:
    """Write the detector as ONNX; its input may have any sides that are multiples of 32.

    What its own metadata says is an input of `width_px` with the context's shape.
    """
    net = fused(net).to(memory_format=torch.contiguous_format)
    width, height = sides_of(width_px)[1]
    write(
        Exported(net),
        {"images": torch.zeros(1, net.channels, height, width)},
        path,
        ("output", "features"),
        open_sides={
            "images": {2: "height", 3: "width"},
            "output": {2: "anchors"},
            "features": {2: "rows", 3: "columns"},
        },
        imgsz=str([height, width]),
        names=str(dict(enumerate(NAMES))),
        stride="32",
        task="detect",
        format="yolo",
        domain=DOMAIN,
        trained_on=seen,
        **({DIFFERENCE: "True"} if net.channels > 3 else {}),
    )
