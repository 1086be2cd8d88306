"""Training of the template tracker, from nothing, on procedural scenes and on stills.

The loss has three parts: the heat map by the focal loss of CenterNet (Zhou et al. 2019, equation
1), place and size by their distance in the cells near the object, and whether the object is there.
"""

# mypy: disallow-untyped-decorators=False
import time
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from operators.tracker.batches import Batch, Batches, normalised, stream
from operators.tracker.model import Deployed, TemplateNet
from operators.tracker.pieces import NEVER_READ, TRAIN_SEEDS, contents, prepare
from operators.tracker.template import INPUTS, OUTPUTS
from operators.tracker.training_settings import TrainSettings
from operators.training import checkpoint
from operators.training.device import device_of
from operators.training.folder import open_folder
from operators.training.identity import of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.onnx_files import fused, write
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine
from pipeline.errors import WeightsError

PHASES = Phases("cut pieces", "train")
AVERAGED = 0.998  # of the weights that are shipped, per step


def losses(net: TemplateNet, given: Batch) -> dict[str, Tensor]:
    """Return the parts of the loss; training minimises their sum."""
    maps, there = net(normalised(given["template"]), given["shape"], normalised(given["search"]))
    logits, heat = maps[:, 0], given["heat"]
    present = given["there"].sum().clamp(min=1)
    sure = logits.sigmoid()
    hit = (heat == 1) * (1 - sure) ** 2 * F.logsigmoid(logits)
    miss = (heat < 1) * (1 - heat) ** 4 * sure**2 * F.logsigmoid(-logits)
    apart = (maps[:, 1:] - given["place"]).abs().mean(1) * given["near"]
    return {
        "heat": -(hit + miss).sum() / present,
        "place": 2 * apart.sum() / given["near"].sum().clamp(min=1),
        "there": F.binary_cross_entropy_with_logits(there, given["there"]),
    }


class Run(checkpoint.Progress):
    """Network, its average, optimiser and place in the plan; a checkpoint holds all of it."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.device = settings, device_of(settings.device)
        self.net = TemplateNet().to(self.device, memory_format=torch.channels_last)
        self.average = TemplateNet().to(self.device)
        self.average.load_state_dict(self.net.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        parts = {"net": self.net, "average": self.average, "optimiser": self.optimiser}
        told = {"stills": " ".join(sorted(place.name for place in settings.stills))}
        if settings.stills:
            told["pictures"] = contents(settings.stills)
        super().__init__(settings.out, parts, of_settings(settings, "stills") | told)

    def follow(self) -> None:
        """Take a step of the average towards the network; it is quicker in the beginning."""
        share = min(AVERAGED, (1 + self.step) / (10 + self.step))
        now = self.net.state_dict()
        with torch.no_grad():
            for name, value in self.average.state_dict().items():
                if value.is_floating_point():
                    value.lerp_(now[name], 1 - share)
                else:
                    value.copy_(now[name])


def kept(settings: TrainSettings) -> Run:
    """The run as its checkpoint has it; raises `WeightsError` where there is none."""
    run = Run(settings)
    if not run.path.exists():
        raise WeightsError(f"{run.path}: expected a checkpoint to export, got no such file")
    run.resume()
    return run


def train(settings: TrainSettings) -> Run:
    """Make missing pieces, train the remaining steps, write checkpoint and log."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    run = Run(settings)
    run.resume()  # another training is refused now, and not after the drawing
    files = prepare(
        settings.data, settings.scenes, settings.moments, settings.stills, PHASES["cut pieces"],
        settings.threads,
    )  # fmt: skip
    run.net.train()
    began = time.monotonic() - run.elapsed_s
    log = settings.out / "log.csv"
    shorten(log, run.step)
    over = run.elapsed_s > settings.minutes * 60
    steps = range(run.step, run.step if over else settings.steps)
    told = ""
    with bar(PHASES["train"], settings.steps, run.step) as shown:
        for given in stream(Batches(files, settings), steps, settings, run.device):
            parts = advance(run, given)
            run.elapsed_s = time.monotonic() - began
            if run.step % EVERY == 0:
                figures = {name: float(part) for name, part in parts.items()}
                note(log, run.step, run.elapsed_s, figures)
                told = " ".join(f"{name} {value:.3f}" for name, value in figures.items())
            shown.step(told)
            run.save_when_due()
            if run.elapsed_s > settings.minutes * 60:
                break
    run.save()
    return run


def advance(run: Run, given: Batch) -> dict[str, Tensor]:
    """One step of the optimiser: the parts of the loss."""
    s = run.settings
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(run.step, peak=s.rate, warmup=s.warmup, steps=s.steps)
    parts = losses(run.net, given)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 5.0)
    run.optimiser.step()
    run.step += 1
    run.follow()
    return {name: part.detach() for name, part in parts.items()}


def export(run: Run, path: Path) -> None:
    """What runs live, as ONNX, with how far the training had come."""
    given = {name: torch.zeros(shape) for name, shape in INPUTS.items()}
    write(
        Deployed(fused(run.average)),
        given,
        path,
        tuple(OUTPUTS),
        steps=f"{run.step} of {run.settings.steps}",
        trained_on=f"scenes from seed {TRAIN_SEEDS}, {run.identity['stills'] or 'no stills'}",
        held_out=" ".join(NEVER_READ),
    )
