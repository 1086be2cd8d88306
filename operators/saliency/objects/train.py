"""Train the robot's detector of objects: `python -m operators.saliency.objects.train --help`.

Contexts of the scripted expert's trials, pushed off its way; one class for grippers, peg and
socket, because the policy learns by itself which of them matters.
"""

# mypy: disallow-untyped-decorators=False
import json
import time
from pathlib import Path

import click
import numpy as np

from operators.saliency.objects.data import CHECK_SEEDS, TRAIN_SEEDS, Boxes, maps_of, pictures
from operators.training.command_line import in_a_sentence
from operators.training.folder import open_folder
from operators.training.progress import Phases, bar, tracked
from pipeline.extras import need

PHASES = Phases("draw contexts", "train", "score")
WARMUP = 100  # steps
CHECK_TRIALS = 20
NEAR_PX = 2.0  # of the context: a detection this near to a centre has found it


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--out", type=Path, required=True, help="objects.onnx, result.json")
@click.option("--trials", default=150, show_default=True, type=click.IntRange(2, 10_000))
@click.option("--pictures", "count", default=12, show_default=True, type=click.IntRange(1, 400))
@click.option("--iterations", default=1000, show_default=True, type=click.IntRange(1))
@click.option("--batch", default=16, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0))
@click.option("--threads", default=2, show_default=True, type=click.IntRange(1))
def command(
    out: Path, trials: int, count: int, iterations: int, batch: int, seed: int, threads: int
) -> None:
    """Train the robot's detector of objects."""
    with in_a_sentence("interrupted; repeat the command to begin anew"):
        need("torch", "train")
        train(out, trials, count, iterations, batch, seed, threads)


def train(
    out: Path, trials: int, count: int, iterations: int, batch: int, seed: int, threads: int
) -> None:
    """Draw, train, score on trials left out, and write the network."""
    import torch

    from operators.saliency.objects.model import CELL_PX, INPUT_PX, ObjectNet, export, loss_of
    from operators.training.schedule import warmed_cosine

    torch.set_num_threads(threads)
    open_folder(out)
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + trials)
    drawn = [pictures(each, count) for each in tracked(seeds, PHASES["draw contexts"])]
    shown, boxes = (np.concatenate(part) for part in zip(*drawn, strict=True))
    torch.manual_seed(seed)
    net = ObjectNet().train()
    optimiser = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-4)
    began = time.monotonic()
    with bar(PHASES["train"], iterations) as progress:
        for step in range(iterations):
            random = np.random.default_rng([seed, step])
            images, placed = augmented(shown, boxes, random, batch, INPUT_PX)
            size = INPUT_PX[1] // CELL_PX, INPUT_PX[0] // CELL_PX
            parts = zip(*(maps_of(each, size, CELL_PX) for each in placed), strict=True)
            for group in optimiser.param_groups:
                group["lr"] = warmed_cosine(step, peak=2e-3, warmup=WARMUP, steps=iterations)
            told, _ = net(torch.from_numpy(images))
            loss = loss_of(told, *(torch.from_numpy(np.stack(part)) for part in parts))
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
            optimiser.step()
            progress.step(f"loss {float(loss.detach()):.3f}")
    path = out / "objects.onnx"
    export(net, path, f"{len(shown)} contexts of the insertion task, seeds {seeds[0]}-{seeds[-1]}")
    facts = {"train_s": round(time.monotonic() - began), **scored(path, CHECK_TRIALS)}
    (out / "result.json").write_text(json.dumps(facts, indent=1) + "\n")
    click.echo(json.dumps(facts))


def augmented(
    shown: Boxes, boxes: Boxes, random: np.random.Generator, batch: int, input_px: tuple[int, int]
) -> tuple[Boxes, Boxes]:
    """Return images (B, 3, H, W) 0..1 and boxes (B, n, 4): shifted, mirrored, relit."""
    width, height = input_px
    rows, columns = shown.shape[1:3]
    images = np.full((batch, height, width, 3), 114 / 255, np.float32)
    placed = []
    for index, row in enumerate(random.integers(len(shown), size=batch)):
        picture, own = shown[row].astype(np.float32) / 255, boxes[row].copy()
        if random.random() < 0.5:
            picture = picture[:, ::-1]
            own[:, [0, 2]] = columns - own[:, [2, 0]]
        picture = picture * random.uniform(0.8, 1.2) + random.normal(0, 0.01, picture.shape)
        left, top = random.integers(0, width - columns + 1), random.integers(0, height - rows + 1)
        images[index, top : top + rows, left : left + columns] = np.clip(picture, 0, 1)
        placed.append(own + np.array([left, top, left, top], np.float32))
    return np.ascontiguousarray(images.transpose(0, 3, 1, 2)), np.stack(placed)


def scored(path: Path, trials: int) -> dict[str, float]:
    """Return precision, recall and the median error of centres on trials left out."""
    from operators.saliency import SaliencySettings
    from operators.saliency.detector import Detector

    settings = SaliencySettings(weights=str(path), confidence=0.3, nms_iou=0.1, class_agnostic=True)
    detector, errors = Detector(settings), list[float]()
    found_count = right = true_count = 0
    for seed in range(CHECK_SEEDS, CHECK_SEEDS + trials):
        for picture, boxes in zip(*pictures(seed, 4), strict=True):
            found, placement, _ = detector.look(picture)
            offset = np.array([placement.left_px, placement.top_px])
            centres = (found.boxes[:, :2] + found.boxes[:, 2:]) / 2 - offset
            true = (boxes[:, :2] + boxes[:, 2:]) / 2
            apart = np.linalg.norm(centres[:, None] / placement.gain - true[None], axis=2)
            found_count, true_count = found_count + len(centres), true_count + len(true)
            if len(centres):
                right += int((apart.min(1) <= NEAR_PX).sum())
                errors += [float(e) for e in apart.min(0) if e <= NEAR_PX]
    return {
        "pictures": 4 * trials,
        "precision": round(right / max(found_count, 1), 4),
        "recall": round(len(errors) / true_count, 4),
        "median_error_px": round(float(np.median(errors or [np.nan])), 3),
    }


if __name__ == "__main__":
    command()
