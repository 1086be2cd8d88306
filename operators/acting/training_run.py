"""Training of the policy that acts, in two rounds: the second has trials of the first's policy."""

# mypy: disallow-untyped-decorators=False
import json
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from operators.acting.data import made_with, read, record
from operators.acting.model import UNIT, ActingNet, export
from operators.acting.training_settings import TrainSettings
from operators.training.arrays import Arrays
from operators.training.checkpoint import Progress, left, path_in
from operators.training.device import device_of, moved
from operators.training.folder import open_folder
from operators.training.identity import Identity, of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine

TRAIN_SEEDS = 2_000  # up to 9,999; the consumer's demonstrations are the trials before
KEPT_OUT = 10  # every tenth moment is for validation
LEAST_SPREAD = 0.02  # radians
PHASES = Phases("trials in turn", "train", "trials of the policy", "train again")
ROUNDS = tuple(zip(PHASES.names[::2], PHASES.names[1::2], strict=True))


def train(settings: TrainSettings, *, say: Callable[[str], None] = print) -> ActingNet:
    """Record missing trials and train both rounds; write checkpoints, logs and acting.onnx."""
    s = settings
    torch.set_num_threads(s.threads)
    open_folder(s.out)
    device_of(s.device)
    paths: list[Path] = []
    weights: Path | None = None
    for number, (trials, training) in enumerate(ROUNDS):
        first = TRAIN_SEEDS + number * s.trials
        out = s.out / f"round_{number + 1}"
        identity = of_settings(s) | {"round": str(number)} | made_with(weights)
        left(path_in(out), identity)  # fail before the trials
        paths += record(
            range(first, first + s.trials), s.data / f"round_{number + 1}", weights=weights,
            workers=s.threads, say=say, name=PHASES[trials],
        )  # fmt: skip
        net = _trained(replace(s, out=out), read(paths), identity, PHASES[training], say)
        weights = out / "acting.onnx"
        export(net, weights)
    export(net, s.out / "acting.onnx")
    return net


def _trained(
    s: TrainSettings, known: Arrays, identity: Identity, phase: str, say: Callable[[str], None]
) -> ActingNet:
    """One round: the remaining steps of a training on all moments so far."""
    open_folder(s.out)
    device = device_of(s.device)
    torch.manual_seed(s.seed)
    net = ActingNet(channels=known["appearance"].shape[-1], joints=known["joints"].shape[-1])
    net.mean.copy_(torch.from_numpy(known["joints"].mean(0)))
    net.spread.copy_(torch.from_numpy(np.maximum(known["joints"].std(0), LEAST_SPREAD)))
    net.to(device)
    optimiser = torch.optim.AdamW(net.parameters(), lr=s.rate, weight_decay=s.decay)
    progress = Progress(s.out, {"net": net, "optimiser": optimiser}, identity)
    progress.resume()
    log = s.out / "log.csv"
    shorten(log, progress.step)
    validation = np.arange(len(known["joints"])) % KEPT_OUT == 0
    rows, kept_out = np.flatnonzero(~validation), np.flatnonzero(validation)
    began = time.monotonic() - progress.elapsed_s
    with bar(phase, s.iterations, progress.step) as shown:
        while progress.step < s.iterations:
            loss = _advance(net, optimiser, known, rows, s, progress.step)
            progress.step += 1
            progress.elapsed_s = time.monotonic() - began
            if progress.step % EVERY == 0:
                note(log, progress.step, progress.elapsed_s, {"loss": loss})
            shown.step(f"loss {loss:.4f}")
            progress.save_when_due()
    progress.save()
    found = judged(net, known, kept_out) | {"train_s": round(progress.elapsed_s)}
    (s.out / "result.json").write_text(json.dumps(found, indent=1) + "\n")
    say(json.dumps(found))
    return net


def _advance(
    net: ActingNet, optimiser: torch.optim.Optimizer, known: Arrays, rows: np.ndarray,
    s: TrainSettings, step: int,
) -> float:  # fmt: skip
    """One step of the optimiser: its loss."""
    rise = max(1, round(s.warmup * s.iterations))
    for group in optimiser.param_groups:
        group["lr"] = warmed_cosine(step, peak=s.rate, warmup=rise, steps=s.iterations)
    random = np.random.default_rng([s.seed, 19, step])
    batch = rows[random.integers(len(rows), size=s.batch)]
    net.train()
    loss = loss_of(net, known, batch)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()
    return float(loss.detach())


def loss_of(net: ActingNet, known: Arrays, rows: np.ndarray) -> Tensor:
    """Huber loss of the gains that were measured, in units of UNIT."""
    told = _told(net, known, rows)
    gains = moved(torch.from_numpy(known["gains"][rows]), told.device)
    tried = ~gains.isnan()
    return torch.nn.functional.smooth_l1_loss(told[tried] / UNIT, gains[tried] / UNIT)


def _told(net: ActingNet, known: Arrays, rows: np.ndarray) -> Tensor:
    given = (
        moved(torch.from_numpy(known[name][rows]), net.mean.device)
        for name in ("facts", "appearance", "joints", "present")
    )
    told: Tensor = net(*given)
    return told


@torch.no_grad()
def judged(net: ActingNet, known: Arrays, rows: np.ndarray) -> dict[str, float]:
    """Return the mean gain of the tried window that is chosen, of the best one, and of all."""
    net.eval()
    gains = known["gains"][rows]
    tried = ~np.isnan(gains)
    told = np.where(tried, _told(deepcopy(net), known, rows).cpu().numpy(), -np.inf)
    chosen = gains[np.arange(len(rows)), told.argmax(1)]
    best, some = np.where(tried, gains, -np.inf).max(1), gains[tried]
    found = {"chosen": chosen.mean(), "best": best.mean(), "any": some.mean()}
    return {"moments": len(rows)} | {name: round(float(v), 6) for name, v in found.items()}
