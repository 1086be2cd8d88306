"""Prediction error of the motion model for several interpretations of the paper's noise values.

`python -m bench.kalman [--data FOLDER] [--seed 7]`: FOLDER is a SoccerNet sequence (the folder with
gt/ and gameinfo.ini); made-up tracks are measured in any case. Prints JSON: mean distance in pixels
between the predicted and the true centre at 1, 4, 8 and 13 frames, and the associator's time.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.machine import facts
from drivers.datasets.sequence import read_rows
from drivers.datasets.soccernet import read_tracklets
from operators.association import Association, AssociationSettings
from pipeline import Detections
from pipeline.errors import FoveaError
from pipeline.executor import Executor
from pipeline.testing import header

AHEAD = (1, 4, 8, 13)  # frames
RATE_HZ = 25.0
Array = NDArray[np.float64]
Path2D = tuple[Array, Array]  # centres (k, 2) px, sizes (k,) px
Reading = tuple[Array, float, Array, float]  # process (2, 2), measurement, first (2, 2), time step


def readings() -> dict[str, Reading]:
    """Return readings of "process noise 0.001, measurement noise 0.01"; lengths in box sizes."""
    one, q, r, tick = np.eye(2), 1e-3, 1e-2, 1 / RATE_HZ
    first = np.diag([r, 1.0])
    return {
        "variances, frames, noise on acceleration (ours)": (white(1.0, q), r, first, 1.0),
        "variances, frames, noise on every state": (q * one, r, one, 1.0),
        "variances, seconds, noise on acceleration": (white(tick, q), r, one, tick),
        "variances, seconds, noise on every state": (q * one, r, one, tick),
        "deviations, frames, noise on acceleration": (white(1.0, q**2), r**2, one, 1.0),
        "ours, lengths in pixels of a 16 px box": (
            white(1.0, q * 256),
            r * 256,
            first * 256,
            1.0,
        ),
    }


def white(step: float, variance: float) -> Array:
    """Return filterpy's discrete white noise on the acceleration, for one axis."""
    block = [[0.25 * step**4, 0.5 * step**3], [0.5 * step**3, step**2]]
    return np.array(block) * variance


def errors(paths: list[Path2D], reading: Reading | None, noise: float, seed: int) -> list[float]:
    """Return the mean error at each of AHEAD with measurement noise of `noise` box sizes.

    Without a reading the last measured place is the prediction.
    """
    rng = np.random.default_rng(seed)
    off: dict[int, list[Array]] = {h: [] for h in AHEAD}
    for centres, sizes in paths:
        measured = centres + rng.normal(size=centres.shape) * noise * sizes[:, None]
        for h in AHEAD:
            if len(centres) > h + 4:
                guess = measured if reading is None else foreseen(measured, reading, h)
                off[h].append(np.linalg.norm(guess[4:-h] - centres[4 + h :], axis=1))
    return [round(float(np.concatenate(off[h]).mean()), 1) for h in AHEAD]


def foreseen(measured: Array, reading: Reading, ahead: int) -> Array:
    """Return the filter's prediction `ahead` frames after each frame: (k, 2) -> (k, 2)."""
    process, noise, covariance, step = reading
    transition = np.array([[1, step], [0, 1]])
    state, out = np.stack([measured[0], np.zeros(2)]), [measured[0]]
    for z in measured[1:]:
        state, covariance = transition @ state, transition @ covariance @ transition.T + process
        gain = covariance[:, 0] / (covariance[0, 0] + noise)
        state = state + gain[:, None] * (z - state[0])
        covariance = covariance - np.outer(gain, covariance[0])
        out.append(state[0] + step * ahead * state[1])
    return np.array(out)


def made_up(seed: int, count: int = 40, frames: int = 200) -> list[Path2D]:
    """Return objects that run straight for a while, then turn or stop, as players do."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        legs = rng.integers(10, 60, frames // 10)
        pace = np.repeat(rng.normal(size=(len(legs), 2)) * rng.choice([0, 2, 5, 12]), legs, axis=0)
        found.append((pace[:frames].cumsum(0), np.full(frames, rng.choice([16.0, 45.0, 60.0]))))
    return found


def footage(folder: Path) -> Iterator[tuple[str, Path2D]]:
    """Yield role and path of every unbroken piece of a tracklet of at least 20 frames.

    Raises `DriverError`.
    """
    tracklets = read_tracklets(folder / "gameinfo.ini")
    found = [(r.id, r.index, *r.box) for r in read_rows(folder / "gt" / "gt.txt", columns=6)]
    rows = np.array(found, np.float64).reshape(-1, 6)
    for track in np.unique(rows[:, 0]).astype(int):
        role = "ball" if track in tracklets and tracklets[track].label == "ball" else "people"
        own = rows[rows[:, 0] == track]
        for piece in np.split(own, np.flatnonzero(np.diff(own[:, 1]) != 1) + 1):
            if len(piece) >= 20:
                sides = piece[:, 4:6] - piece[:, 2:4]
                yield role, (piece[:, 2:4] + sides / 2, np.sqrt(sides.prod(axis=1)))


def associator_ms(objects: int, seed: int, frames: int = 200) -> dict[str, float]:
    """Return the time per frame of the whole operator with `objects` players of 40x90 px."""
    rng = np.random.default_rng(seed)
    at = rng.uniform((50, 50), (1870, 1030), (objects, 2))
    pace = rng.normal(size=(objects, 2)) * 3
    subject, spent = Association(AssociationSettings()), []
    executor = Executor("association", subject)
    subject.open()
    for k in range(frames):
        corner = at + k * pace + rng.normal(size=at.shape)
        detections = Detections(
            header=header(k),
            boxes=np.concatenate([corner, corner + np.array([40, 90])], axis=1).astype(np.float32),
            angles=np.zeros(objects, np.float32),
            scores=np.full(objects, 0.8, np.float32),
            labels=np.ones(objects, np.int32),
            features=np.zeros((objects, 64), np.float32),
            names=("ball", "player"),
        )
        start = time.perf_counter_ns()
        executor.call({"detections": detections})
        spent.append((time.perf_counter_ns() - start) / 1e6)
    return {f"p{q}": round(float(np.percentile(spent, q)), 3) for q in (50, 99)}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    if options.seed < 0:
        parser.error(f"--seed: must be at least 0, got {options.seed}")
    sets: dict[str, list[Path2D]] = {"made-up": made_up(options.seed)}
    try:
        for role, piece in footage(options.data) if options.data else ():
            sets.setdefault(role, []).append(piece)
    except FoveaError as error:
        parser.error(str(error))
    table = {
        f"{name}, measured to {noise} box": {
            title: errors(paths, reading, noise, options.seed)
            for title, reading in {**readings(), "hold the last place": None}.items()
        }
        for name, paths in sets.items()
        for noise in (0.0, 0.1)
    }
    result = {
        **facts(),
        "seed": options.seed,
        "ahead_frames": AHEAD,
        "error_px": table,
        "associator_ms_at_25_objects": associator_ms(25, options.seed),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
