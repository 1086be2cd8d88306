"""Frames of drawn drives through a street, with the corners of their texts: seed -> pictures."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from drivers.scenes.road import RoadScene
from operators.saliency.text.examples import KEPT_PX, PICTURES
from operators.saliency.text.streets import FULL_PX, Picture
from operators.training.identity import Identity, of_code

SPAN = 400  # frames of each clip over which its pictures are spread


def made_of_roads() -> Identity:
    """What decides the pictures of a clip beside its seed."""
    return of_code("drivers.scenes.road") | {"pictures": str(PICTURES), "span": str(SPAN)}


def road(seed: int) -> list[Picture]:
    """Return pictures of a clip as they are kept for training."""
    reduce = FULL_PX[0] // KEPT_PX[0]
    return [
        replace(picture, quads=picture.quads / np.float32(reduce))
        for picture in roads([seed], PICTURES, FULL_PX, reduce)
    ]


def roads(
    seeds: Iterable[int], count: int, size_px: tuple[int, int], reduce: int
) -> Iterator[Picture]:
    """Yield `count` well-spaced frames of the clip of each seed, shrunk as a sensor shrinks them.

    Each pixel is the mean of `reduce` x `reduce`; corners are in pixels of `size_px`. Texts that
    are not to be read in a frame, small, hidden or of another script, may be found or not.
    """
    width, height = size_px
    for seed in seeds:
        scene = RoadScene(size_px=size_px, seed=seed)
        parts = np.random.default_rng([seed, 1]).random(count) + np.arange(count)
        for index in (parts * SPAN / count).astype(int):
            told = scene.quads(int(index))
            pixels = np.empty((height // reduce, width // reduce, 3), np.uint8)
            scene.window(int(index), 0, 0, width, height, reduce, pixels)
            yield Picture(
                pixels=pixels,
                quads=np.array([t.corners for t in told], np.float32).reshape(-1, 4, 2),
                ignored=np.array([not t.legible for t in told], np.bool_),
            )
        scene.close()
