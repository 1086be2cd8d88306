"""Pictures for the detector: seeds of trials in, small contexts and the boxes of objects out."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from drivers.scenes.insertion import STEPS, InsertionScene, demonstration

CONTEXT_PX = (109, 82)  # 0.17x of 640x480
TRAIN_SEEDS, CHECK_SEEDS = 1_000, 51_000  # no other part of the project looks at these trials
PUSHED_RAD, PUSHED_STEPS = 0.03, 20.0  # so that the arms are not only where the expert has them
SPREAD_CELLS = 1.0  # of the heat around a centre
Boxes = NDArray[np.float32]  # (n, 4) xyxy, pixels of the context


def pictures(seed: int, count: int) -> tuple[NDArray[np.uint8], Boxes]:
    """Return `count` contexts (count, 82, 109, 3) of a trial and the boxes (count, n, 4)."""
    random = np.random.default_rng([seed, 7])
    targets = demonstration(seed)
    noise = gaussian_filter1d(random.standard_normal(targets.shape), PUSHED_STEPS, axis=0)
    targets += (noise * PUSHED_RAD / noise.std()).astype(np.float32)
    scene = InsertionScene(seed=seed)
    scene.act(0, targets)
    shown, boxes = [], []
    scale = np.tile(np.array(CONTEXT_PX) / scene.size_px, 2)
    for index in np.sort(random.choice(STEPS, count, replace=False)):
        picture = scene.picture(int(index))
        shown.append(cv2.resize(picture, CONTEXT_PX, interpolation=cv2.INTER_AREA))
        boxes.append(scene.truth(int(index)).boxes * scale)
    scene.close()
    return np.stack(shown), np.array(boxes, np.float32)


def maps_of(boxes: Boxes, size: tuple[int, int], cell_px: int) -> tuple[NDArray[np.float32], ...]:
    """Return heat (1, r, c), boxes (4, r, c) and weight (1, r, c) of a picture's objects.

    `size` is rows and columns. A small object comes last, so that it is told where two meet.
    """
    rows, columns = size
    heat, weight = (
        np.zeros((1, rows, columns), np.float32),
        np.zeros((1, rows, columns), np.float32),
    )
    told = np.ones((4, rows, columns), np.float32)
    y, x = np.mgrid[:rows, :columns] + 0.5
    sides = boxes[:, 2:] - boxes[:, :2]
    for row in np.argsort(-sides.prod(1)):
        if sides[row].min() < 0.5:
            continue  # outside the picture
        centre = (boxes[row, :2] + boxes[row, 2:]) / 2
        column, line = (
            min(math.floor(c / cell_px), n - 1)
            for c, n in zip(centre, (columns, rows), strict=True)
        )
        around = ((x - column - 0.5) ** 2 + (y - line - 0.5) ** 2) / (2 * SPREAD_CELLS**2)
        np.maximum(heat[0], np.exp(-around), out=heat[0])
        near = (around <= 1 / SPREAD_CELLS**2).nonzero()
        told[:2, near[0], near[1]] = centre[:, None]
        told[2:, near[0], near[1]] = sides[row][:, None]
        weight[0, near[0], near[1]] = 1
    return heat, told, weight
