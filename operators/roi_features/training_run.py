"""Training of the ROI encoder on procedural scenes and labelled stills.

It has two objectives. Classification, including false candidates: in the context, a ball and a boot
are four pixels each; at full resolution they can be distinguished. Identification, by supervised
contrastive loss (Khosla et al. 2020) within each scene: a policy must recognise a person, and
team mates differ only in number, skin, hair and build.

With `--head-of CHECKPOINT` the features are frozen, so that policies trained on them stay valid;
only the classification is trained again.
"""

# mypy: disallow-untyped-decorators=False
import time
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from operators.roi_features import stills
from operators.roi_features.data import ANYONE, CROP_PX, NOBODY, Crops, load, made_with, render
from operators.roi_features.model import CLASSES, EncoderNet, load_imagenet
from operators.roi_features.training_settings import OF_SCENE, TrainSettings
from operators.training import checkpoint
from operators.training.device import device_of, moved
from operators.training.folder import open_folder
from operators.training.identity import of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.onnx_files import fused, write
from operators.training.photometric import degrade, recolour
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine
from operators.training.stills import contents

PHASES = Phases("draw crops", "cut out stills", "train")
TRAIN_SEEDS = 20_000  # no other part of the project uses them
TEMPERATURE = 0.1
# crops of one scene in a batch: that many people, twice each, the ball, and false candidates
PEOPLE, BALLS = 7, 3


def scenes_of(
    crops: Crops, count: int, share: float, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw scenes (count,), stills with that share where there are some."""
    known = np.unique(crops.scenes)
    still = known >= stills.FIRST_SCENE
    if still.any() and not still.all():
        of_stills = int(rng.binomial(count, share))
        return np.concatenate(
            [
                rng.choice(known[~still], count - of_stills, replace=False),
                rng.choice(known[still], min(of_stills, int(still.sum())), replace=False),
            ]
        )
    return np.asarray(rng.choice(known, count, replace=False))


def batch_rows(
    crops: Crops, size: int, rng: np.random.Generator, share: float = 0.5
) -> NDArray[np.intp]:
    """Rows of a batch: some scenes, of each some people at two moments, the ball, false ones."""
    rows: list[NDArray[np.intp]] = []
    for scene in scenes_of(crops, size // OF_SCENE, share, rng):
        own = np.flatnonzero(crops.scenes == scene)
        ball = own[crops.kinds[own] == CLASSES.index("ball")]
        false = own[crops.kinds[own] == CLASSES.index("background")]
        persons, times = np.unique(crops.persons[own], return_counts=True)
        twice = rng.permutation(persons[(persons != NOBODY) & (times > 1)])[:PEOPLE]
        chosen = [rng.choice(own[crops.persons[own] == p], 2, replace=False) for p in twice]
        chosen.append(rng.choice(ball, BALLS) if len(ball) else ball)
        rest = false if len(false) else own  # no false ones in a still whose ball is not marked
        chosen.append(rng.choice(rest, OF_SCENE - sum(map(len, chosen))))
        rows += chosen
    return np.concatenate(rows)


def changed(
    picture: NDArray[np.uint8], light: int, rng: np.random.Generator, *, mirror: bool
) -> NDArray[np.uint8]:
    """Augment a crop: shift, zoom, coarsen, relight, soften, mirror.

    Crops of the same `light` are relit alike, as one camera shows a shirt in one colour.
    """
    side, zoom = -1 if mirror else 1, np.exp(rng.uniform(-0.2, 0.2))
    middle = (CROP_PX - 1) / 2  # OpenCV maps pixels by their number, whose centres lie at halves
    shift = middle * (1 - np.array([side * zoom, zoom])) + rng.uniform(-7, 7, 2)
    matrix = np.array([[side * zoom, 0, shift[0]], [0, zoom, shift[1]]])
    size = (CROP_PX, CROP_PX)
    moved = cv2.warpAffine(picture, matrix, size, borderMode=cv2.BORDER_REFLECT_101)
    if rng.random() < 0.3:  # a ball of ten pixels, a player of forty
        few = int(rng.integers(10, 50))
        coarse = cv2.resize(moved, (few, few), interpolation=cv2.INTER_AREA)
        moved = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
    lit = recolour(np.asarray(moved, np.uint8), np.random.default_rng([light, 13]))
    return degrade(lit, rng)


def identity_loss(vectors: Tensor, persons: Tensor, scenes: Tensor) -> Tensor:
    """Supervised contrast of people's features (n, d) among those of their own scene.

    0 for a batch in which nobody is twice: the mean of no one would be no number, and after its
    gradient no weight would be one either.
    """
    known = persons != NOBODY
    vectors = F.normalize(vectors[known], dim=1)
    persons, scenes = persons[known], scenes[known]
    likeness = vectors @ vectors.T / TEMPERATURE
    other = ~torch.eye(len(vectors), dtype=torch.bool, device=vectors.device)
    rivals = (scenes[:, None] == scenes) & other
    same = rivals & (persons[:, None] == persons)
    spread = likeness.masked_fill(~rivals, -1e4).logsumexp(1, keepdim=True)
    each = ((likeness - spread) * same).sum(1) / same.sum(1).clamp(min=1)
    twice = same.any(1)
    return -(each * twice).sum() / twice.sum().clamp(min=1)


def class_loss(logits: Tensor, kinds: Tensor) -> Tensor:
    """Cross-entropy of the classes; of ANYONE, that it is a player or a referee."""
    anyone = kinds == ANYONE
    known = F.cross_entropy(
        logits, kinds.masked_fill(anyone, 0), label_smoothing=0.02, reduction="none"
    )
    person = -logits.log_softmax(1)[:, : CLASSES.index("ball")].logsumexp(1)  # people come first
    return torch.where(anyone, person, known).mean()


def losses(net: EncoderNet, given: dict[str, Tensor], weight: float) -> dict[str, Tensor]:
    """Return both losses; training minimises their sum."""
    # in bfloat16 depthwise convolutions are slower, and a step takes twice as long
    features, kinds = net(given["pictures"])
    what = class_loss(kinds, given["kinds"])
    who = identity_loss(features, given["persons"], given["scenes"])
    return {"what": what, "who": weight * who}  # only reported if the features are frozen


class Run(checkpoint.Progress):
    """Network, optimiser and place in the plan; a checkpoint holds all of it."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.device = settings, device_of(settings.device)
        self.net = EncoderNet()
        if settings.init is not None:
            load_imagenet(self.net, settings.init)
        if settings.head_of is not None:
            checkpoint.take(settings.head_of, {"net": self.net})
            self.net.features.requires_grad_(False)
        self.net = self.net.to(self.device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.AdamW(
            [p for p in self.net.parameters() if p.requires_grad],
            lr=settings.rate,
            weight_decay=settings.decay,
        )
        parts = {"net": self.net, "optimiser": self.optimiser}
        crops = made_with(settings.moments, settings.span)
        if settings.stills:
            files = [path for folder in settings.stills for path in stills.of_training(folder)]
            crops |= stills.made_with() | {"stills": contents(files)}
        super().__init__(settings.out, parts, of_settings(settings, "stills") | crops)

    def prepare(self) -> None:
        """Switch to training mode; frozen layers keep their batch statistics."""
        self.net.train()
        if self.settings.head_of is not None:
            self.net.features.eval()


def train(settings: TrainSettings) -> EncoderNet:
    """Render missing crops, train the remaining steps, write checkpoint and log."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    run = Run(settings)
    run.resume()  # another training is refused now, and not after the drawing
    seeds = range(TRAIN_SEEDS, TRAIN_SEEDS + settings.scenes)
    files = render(
        seeds, settings.moments, settings.span, settings.data, settings.threads,
        PHASES["draw crops"],
    )  # fmt: skip
    files += stills.prepare(settings.data / "stills", settings.stills, PHASES["cut out stills"])
    crops = load(files)
    run.prepare()
    began = time.monotonic() - run.elapsed_s
    log = settings.out / "log.csv"
    shorten(log, run.step)
    with bar(PHASES["train"], settings.steps, run.step) as shown:
        while run.step < settings.steps and run.elapsed_s < settings.minutes * 60:
            figures = advance(run, crops)
            run.elapsed_s = time.monotonic() - began
            if run.step % EVERY == 0:
                note(log, run.step, run.elapsed_s, figures)
            shown.step(" ".join(f"{name} {value:.3f}" for name, value in figures.items()))
            run.save_when_due()
    run.save()
    return run.net


def advance(run: Run, crops: Crops) -> dict[str, float]:
    """One step of the optimiser: the parts of the loss."""
    s = run.settings
    rng = np.random.default_rng([s.seed, 12, run.step])
    rows = batch_rows(crops, s.batch, rng, s.stills_share)
    # mirroring would change a shirt number
    mirrored = (crops.persons[rows] == NOBODY) & (rng.random(len(rows)) < 0.5)
    pictures = [
        changed(
            crops.pictures[row], run.step << 20 | int(crops.scenes[row]), rng, mirror=bool(turn)
        )
        for row, turn in zip(rows, mirrored, strict=True)
    ]
    drawn = {
        "pictures": torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2),
        "kinds": torch.from_numpy(crops.kinds[rows]),
        "persons": torch.from_numpy(crops.persons[rows]),
        "scenes": torch.from_numpy(crops.scenes[rows]),
    }
    given = {name: moved(values, run.device) for name, values in drawn.items()}
    given["pictures"] = given["pictures"].float().div_(255)
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(run.step, peak=s.rate, warmup=s.warmup, steps=s.steps)
    parts = losses(run.net, given, s.identity)
    run.optimiser.zero_grad(set_to_none=True)
    torch.stack(list(parts.values())).sum().backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 5.0)
    run.optimiser.step()
    run.step += 1
    return {name: float(part.detach()) for name, part in parts.items()}


def export(net: EncoderNet, path: Path) -> None:
    """What runs live, as ONNX: crops (n, 3, 96, 96) -> features (n, 576), classes (n, 4)."""
    crops = torch.zeros(2, 3, CROP_PX, CROP_PX)
    write(
        fused(net).to(memory_format=torch.contiguous_format),
        {"crops": crops},
        path,
        ("features", "classes"),
        open_sides={name: {0: "n"} for name in ("crops", "features", "classes")},
        classes=" ".join(CLASSES),
    )
