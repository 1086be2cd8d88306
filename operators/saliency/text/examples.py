"""Pictures to train on, drawn once: seeds -> one pair of files for each part of them.

They are kept at twice the resolution of a context, so that the training can zoom. Part n holds
drawn streets of seed n, or frames of a road clip of seed n.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from operators.saliency.text.photographs import contents, part_of
from operators.saliency.text.streets import Picture, street
from operators.training.arrays import outdated, write
from operators.training.identity import Identity, of_code
from operators.training.progress import tracked
from operators.training.workers import pool_of

KEPT_PX = (640, 360)  # width, height of a kept picture
CONTEXT_PX = (320, 180)
INPUT_PX = (320, 192)  # the same with sides that are multiples of 32
PICTURES = 16  # of a part
CODE = ("operators.saliency.text.streets", "operators.saliency.text.words")


def kept(picture: Picture) -> Picture:
    """Return a picture as it is kept: shrunk by area, as a sensor shrinks its context."""
    height, width = picture.pixels.shape[:2]
    small = cv2.resize(picture.pixels, KEPT_PX, interpolation=cv2.INTER_AREA)
    gain = np.array([KEPT_PX[0] / width, KEPT_PX[1] / height], np.float32)
    return Picture(
        pixels=np.asarray(small, np.uint8), quads=picture.quads * gain, ignored=picture.ignored
    )


def drawn(seed: int, stills: Sequence[Path] = ()) -> list[Picture]:
    """Draw the streets of a seed, every other one upon a photograph where there are any."""
    pictures = []
    for number in range(PICTURES):
        rng = np.random.default_rng([seed, number])
        behind = None
        if stills and number % 2:
            behind = part_of(stills[int(rng.integers(len(stills)))], rng)
        pictures.append(kept(street(rng, behind)))
    return pictures


def draw(
    seeds: Iterable[int], folder: Path, made: Identity, how: Callable[[int], list[Picture]],
    workers: int, name: str,
) -> None:  # fmt: skip
    """Draw the parts of seeds into `folder`; those there that were made alike are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    files = (folder / f"{seed}.npz" for seed in seeds)
    missing = outdated(files, made, print, with_pictures=True)
    with pool_of(workers) as pool:
        jobs = [pool.submit(_draw, path, made, how) for path in missing]
        for job in tracked(jobs, name):
            job.result()


def made_of_streets(stills: Sequence[Path] = ()) -> Identity:
    """What decides the streets of a seed."""
    made = of_code(*CODE) | {"pictures": str(PICTURES)}
    if not stills:
        return made
    return made | of_code("operators.saliency.text.photographs") | {"stills": contents(stills)}


def _draw(path: Path, made: Identity, how: Callable[[int], list[Picture]]) -> None:
    cv2.setNumThreads(1)
    pictures = how(int(path.stem))
    truth = {
        "first": np.cumsum([0, *(len(p.quads) for p in pictures)]),
        "quads": np.concatenate([p.quads for p in pictures]),
        "ignored": np.concatenate([p.ignored for p in pictures]),
    }
    write(path, truth, made, np.stack([p.pixels for p in pictures]))
