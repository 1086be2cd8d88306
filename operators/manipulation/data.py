"""Demonstrations for training: seeds of trials in, files of pictures, joints and targets out.

A scripted expert inserts the peg. Three of four demonstrations are disturbed: the arms are pushed
off the expert's targets by slowly changing noise, while the targets written down stay the expert's.
Without it the network tells the targets by where the arms already are, not by where the objects
lie, and its own small errors add up.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from drivers.scenes.insertion import COMPLETE, STEPS, Simulation, demonstration
from drivers.scenes.insertion.physics import SIZE_PX
from drivers.scenes.insertion.simulation import PEG, SOCKET, VIEW
from operators.manipulation.picture import PICTURE_PX, WORKPLACE, place
from operators.training import arrays as files
from operators.training.arrays import Arrays
from operators.training.identity import Identity, of_code
from operators.training.progress import tracked
from operators.training.workers import pool_of
from pipeline.errors import DriverError

TRAIN_SEEDS = 0  # up to 9,999; no other part of the project looks at these trials
CHECK_SEEDS = 50_000  # up to 59,999: looked at while choosing
DISTURBED_RAD = 0.05  # standard deviation of the push, about 25 mm at the gripper
DISTURBED_STEPS = 12.0  # over which it changes
SEEN_STEPS = 165  # peg and socket lie where they were, and no gripper hides them
CALM = (140, 235), (285, STEPS)  # while objects are taken and joined: pushed, most would be lost
UNDISTURBED = 4  # every one of so many trials
GRIPPERS = (6, 13)
NAMES = ("pictures", "joints", "steps", "targets", "places")


def record(
    seeds: Iterable[int],
    folder: Path,
    *,
    frames: int,
    workers: int,
    say: Callable[[str], None],
    name: str,
) -> list[Path]:
    """Return a file per seed; those missing, or made otherwise, are made."""
    folder.mkdir(parents=True, exist_ok=True)
    made = made_with(frames)
    paths = {folder / f"{seed:05d}.npz": seed for seed in seeds}
    missing = files.outdated(paths, made, say)
    if missing:
        with pool_of(workers) as pool:
            jobs = [pool.submit(_record, path, paths[path], frames, made) for path in missing]
            for job in tracked(jobs, name):
                job.result()
    return [*paths]


def made_with(frames: int) -> dict[str, str]:
    """What determines a demonstration, beside its seed."""
    return {
        "frames": str(frames),
        "picture_px": str(PICTURE_PX),
        "disturbed": f"{DISTURBED_RAD} {DISTURBED_STEPS} {CALM} {UNDISTURBED}",
        "places": str(SEEN_STEPS),
        **of_code("drivers.scenes.insertion"),
    }


def read(paths: Iterable[Path]) -> Arrays:
    """Return all demonstrations (n) with their k frames each in one array a name.

    pictures (n, k, h, w, 3) uint8, joints (n, k, 14), steps (n, k), targets (n, 400, 14), and
    places (n, k, 2, 2) of peg and socket in the picture, -1 to 1, NaN once they were taken.
    Raises `DriverError` for a file that is none of these.
    """
    found: dict[str, list[NDArray[np.generic]]] = {}
    for path in paths:
        read = files.read(path)
        if not set(NAMES) <= set(read):
            raise DriverError(f"{path}: expected a demonstration; record it again")
        for name in NAMES:
            found.setdefault(name, []).append(read[name])
    return {name: np.stack(values) for name, values in found.items()}


def _record(path: Path, seed: int, frames: int, made: Identity) -> None:
    files.write(path, demonstrated(seed, frames), made)


def demonstrated(seed: int, frames: int) -> Arrays:
    """Return one demonstration, with `frames` pictures spread over it at random."""
    random = np.random.default_rng([seed, 5])
    targets = demonstration(seed)
    edges = np.linspace(0, STEPS, frames + 1)
    steps = np.floor(random.uniform(edges[:-1], edges[1:])).astype(np.int32)
    push = np.zeros_like(targets)
    if seed % UNDISTURBED:
        push = disturbance(random)
    simulation = Simulation(seed)
    pictures = np.empty((frames, PICTURE_PX[1], PICTURE_PX[0], 3), np.uint8)
    joints = np.empty((frames, targets.shape[1]), np.float32)
    for step in range(STEPS):
        for index in np.flatnonzero(steps == step):
            seen = simulation.picture()
            whole = (0, 0, seen.shape[1], seen.shape[0])
            place(seen, whole, whole[2:], pictures[index])
            joints[index] = simulation.joints()
        simulation.step(targets[step] + push[step])
    lying = (steps < SEEN_STEPS)[:, None, None]
    complete = np.array(simulation.best == COMPLETE)
    simulation.close()
    return {
        "pictures": pictures, "joints": joints, "steps": steps, "targets": targets,
        "places": np.where(lying, places_of(seed), np.float32(np.nan)), "complete": complete,
    }  # fmt: skip


def places_of(seed: int) -> NDArray[np.float32]:
    """Return where peg and socket lie in the picture (2, 2) at the start, x and y in -1..1."""
    simulation = Simulation(seed)
    width, height = SIZE_PX
    corners = [simulation.physics.corners(shapes) for shapes in ((PEG,), SOCKET)]
    seen = [simulation.physics.projected(each, VIEW).mean(0) for each in corners]
    shares = np.array(seen) / (width, height)
    low, high = np.array(WORKPLACE[:2]), np.array(WORKPLACE[2:])
    return np.asarray(2 * (shares - low) / (high - low) - 1, np.float32)


def disturbance(random: np.random.Generator) -> NDArray[np.float32]:
    """Return what is added to the targets (400, 14), radians; nothing to the grippers."""
    noise = random.standard_normal((STEPS, 14))
    smooth = gaussian_filter1d(noise, DISTURBED_STEPS, axis=0)
    smooth *= DISTURBED_RAD / smooth.std()
    smooth[:, GRIPPERS] = 0
    loud = np.ones(STEPS)
    for begin, end in CALM:
        loud[begin:end] = 0
    smooth *= gaussian_filter1d(loud, 6, mode="nearest")[:, None]
    return np.asarray(smooth, np.float32)
