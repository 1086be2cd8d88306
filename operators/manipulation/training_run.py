"""Training of the consumer on scripted demonstrations, at full resolution."""

# mypy: disallow-untyped-decorators=False
import json
import time
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drivers.scenes.insertion import COMPLETE, PARTIAL, STEPS, Simulation
from operators.manipulation.data import (
    CHECK_SEEDS,
    GRIPPERS,
    TRAIN_SEEDS,
    made_with,
    read,
    record,
)
from operators.manipulation.ensemble import Ensemble
from operators.manipulation.model import ActNet, Shape, export, loss_of
from operators.manipulation.picture import PICTURE_PX, place
from operators.manipulation.training_settings import TrainSettings
from operators.training.checkpoint import Progress, left, path_in, take
from operators.training.device import device_of, mixed_precision, moved
from operators.training.folder import open_folder
from operators.training.identity import of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine

CLIPS, TRAIN, SCORE = "record demonstrations", "train", "try"
PHASES = Phases(CLIPS, TRAIN, SCORE)
EXPORT_EVERY = 500  # steps: what was trained so far can be tried meanwhile
LEAST_SPREAD = 0.05  # radians; a joint that hardly moves is not told finer than that
DECAY = 0.01  # of the ensemble


class Demonstrations:
    """Batches of pictures, joints and the targets that followed."""

    def __init__(self, paths: list[Path], chunk: int) -> None:
        self._read = read(paths)
        self._chunk = chunk

    def batch(self, random: np.random.Generator, size: int) -> tuple[Tensor, ...]:
        """Pictures (B, h, w, 3) uint8, joints (B, 14), targets (B, chunk, 14), places (B, 2, 2)."""
        known = self._read
        clips, frames = known["steps"].shape
        clip, frame = random.integers(clips, size=size), random.integers(frames, size=size)
        rows = known["steps"][clip, frame][:, None] + np.arange(self._chunk)
        targets = known["targets"][clip[:, None], np.minimum(rows, STEPS - 1)]
        pictures, joints, places = (
            known[name][clip, frame] for name in ("pictures", "joints", "places")
        )
        return tuple(torch.from_numpy(each) for each in (pictures, joints, targets, places))

    def scale(self) -> tuple[Tensor, Tensor]:
        """Mean and spread (14,) of the targets."""
        targets = self._read["targets"].reshape(-1, self._read["targets"].shape[-1])
        spread = np.maximum(targets.std(0), LEAST_SPREAD)
        return torch.from_numpy(targets.mean(0)), torch.from_numpy(spread.astype(np.float32))


def train(settings: TrainSettings, *, say: Callable[[str], None] = print) -> None:
    """Record missing demonstrations, train the remaining steps, write checkpoint, log, network."""
    s = settings
    torch.set_num_threads(s.threads)
    open_folder(s.out)
    device = device_of(s.device)
    identity = of_settings(s, "trials") | made_with(s.frames)
    left(path_in(s.out), identity)  # fail before the recording
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + s.demonstrations)
    paths = record(seeds, s.data, frames=s.frames, workers=s.threads, say=say, name=PHASES[CLIPS])
    demonstrations = Demonstrations(paths, s.chunk)
    torch.manual_seed(s.seed)
    net = ActNet(Shape(chunk=s.chunk), *demonstrations.scale()).to(device)
    if s.init:
        take(s.init, {"net": net})
    optimiser = torch.optim.AdamW(net.parameters(), lr=s.rate, weight_decay=s.decay)
    progress = Progress(s.out, {"net": net, "optimiser": optimiser}, identity)
    progress.resume()
    log = s.out / "log.csv"
    shorten(log, progress.step)
    began = time.monotonic() - progress.elapsed_s
    with bar(PHASES[TRAIN], s.iterations, progress.step) as shown:
        while progress.step < s.iterations:
            loss, error = _advance(net, optimiser, demonstrations, s, progress.step)
            progress.step += 1
            progress.elapsed_s = time.monotonic() - began
            if progress.step % EVERY == 0:
                note(log, progress.step, progress.elapsed_s, {"loss": loss, "error": error})
            if progress.step % EXPORT_EVERY == 0:
                export_copy(net, s.out / "act.onnx")
            shown.step(f"loss {loss:.4f} error {error:.4f}")
            progress.save_when_due()
    progress.save()
    export_copy(net, s.out / "act.onnx")
    if s.trials:
        with bar(PHASES[SCORE], 1) as shown:
            rewards = tried(net, range(CHECK_SEEDS, CHECK_SEEDS + s.trials))
            shown.step()
        facts = figures(rewards) | {"train_s": round(progress.elapsed_s)}
        (s.out / "result.json").write_text(json.dumps(facts, indent=1) + "\n")
        say(json.dumps(facts))


def _advance(
    net: ActNet,
    optimiser: torch.optim.Optimizer,
    demonstrations: Demonstrations,
    s: TrainSettings,
    step: int,
) -> tuple[float, float]:
    """One step of the optimiser: loss and error."""
    device = net.mean.device
    random = np.random.default_rng([s.seed, 13, step])
    picture, joints, targets, places = (
        moved(each, device) for each in demonstrations.batch(random, s.batch)
    )
    # the grippers tell how far the trial has come, and nothing of where things lie
    noise = torch.from_numpy(random.normal(0, s.noise, joints.shape)).to(joints)
    noise[:, list(GRIPPERS)] = 0
    joints = joints + noise
    rise = max(1, round(s.warmup * s.iterations))
    for group in optimiser.param_groups:
        group["lr"] = warmed_cosine(step, peak=s.rate, warmup=rise, steps=s.iterations)
    net.train()
    torch.manual_seed(s.seed * s.iterations + step)
    with mixed_precision(device):
        loss, error = loss_of(
            net, picture, joints, targets, places, divergence=s.divergence, guide=s.guide
        )
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimiser.step()
    return float(loss.detach()), float(error)


def export_copy(net: ActNet, path: Path) -> None:
    """Write the network as it is now."""
    export(deepcopy(net), path)


@torch.no_grad()
def tried(net: ActNet, seeds: range) -> list[int]:
    """Return the best reward of a closed-loop trial per seed, at full resolution."""
    net.eval()
    device, rewards = net.mean.device, []
    picture = np.zeros((PICTURE_PX[1], PICTURE_PX[0], 3), np.uint8)

    def answer(joints: NDArray[np.float32]) -> NDArray[np.float32]:
        given = torch.from_numpy(picture)[None], torch.from_numpy(joints)[None]
        return np.asarray(net(*(each.to(device) for each in given))[0].cpu().numpy())

    simulation = Simulation(seeds[0])
    for seed in seeds:
        simulation.reset(seed)
        ensemble = Ensemble(DECAY)
        for step in range(STEPS):
            seen = simulation.picture()
            whole = (0, 0, seen.shape[1], seen.shape[0])
            place(seen, whole, (whole[2], whole[3]), picture)
            ensemble.add(step, answer(simulation.joints()))
            if simulation.step(ensemble.targets(step, 1)[0]) == COMPLETE:
                break
        rewards.append(simulation.best)
    simulation.close()
    return rewards


def figures(rewards: list[int]) -> dict[str, float]:
    """Return shares of trials that were complete, and at least partial."""
    found = np.array(rewards)
    return {
        "trials": len(found),
        "complete": round(float((found >= COMPLETE).mean()), 4),
        "partial": round(float((found >= PARTIAL).mean()), 4),
    }
