"""Frames of drawn drives through a street, with the corners of their texts: seed -> pictures."""

from collections.abc import Iterable, Iterator

import numpy as np

from drivers.scenes.road import RoadScene
from operators.saliency.text.examples import PICTURES, kept
from operators.saliency.text.streets import FULL_PX, Picture
from operators.training.identity import Identity, of_code

SPAN = 400  # frames of each clip over which its pictures are spread


def made_of_roads() -> Identity:
    """What decides the pictures of a clip beside its seed."""
    return of_code("drivers.scenes.road") | {"pictures": str(PICTURES), "span": str(SPAN)}


def road(seed: int) -> list[Picture]:
    """Return pictures of a clip as they are kept for training."""
    return [kept(picture) for picture in roads([seed], PICTURES)]


def roads(seeds: Iterable[int], count: int) -> Iterator[Picture]:
    """Yield `count` well-spaced pictures of the clip of each seed, at full resolution.

    Texts that are not to be read in a frame, small, hidden or of another script, may be found.
    """
    for seed in seeds:
        scene = RoadScene(size_px=FULL_PX, seed=seed)
        parts = np.random.default_rng([seed, 1]).random(count) + np.arange(count)
        for index in (parts * SPAN / count).astype(int):
            told = scene.quads(int(index))
            yield Picture(
                pixels=scene.picture(int(index)),
                quads=np.array([t.corners for t in told], np.float32).reshape(-1, 4, 2),
                ignored=np.array([not t.legible for t in told], np.bool_),
            )
        scene.close()
