"""Trials for training: seeds in, a file per seed of windows and their gains out."""

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.acting.network import ActingNetwork
from operators.acting.rollout import Moment, Trial, Valued
from operators.acting.windows import FACTS
from operators.association import AssociationSettings
from operators.saliency import SaliencySettings
from operators.training import arrays as files
from operators.training.arrays import Arrays
from operators.training.identity import Identity, of_code
from operators.training.progress import tracked
from operators.training.workers import pool_of
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest

EVERY, TRIED = 5, 10  # frames between moments, windows whose gain is measured in each
MOST = 48  # windows of a moment that are kept
AGE = 6  # of the facts: how long ago the window was shown
RANDOM = 0.5, 0.2  # share of frames with a window at random: in the first round, in later ones
NAMES = ("facts", "appearance", "joints", "gains")
SALIENCY = SaliencySettings(weights="objects", confidence=0.3, nms_iou=0.1)  # as the graph has it


def record(
    seeds: Iterable[int],
    folder: Path,
    *,
    weights: Path | None,
    workers: int,
    name: str,
    say: Callable[[str], None],
) -> list[Path]:
    """Return a file per seed; those missing, or made otherwise, are made.

    `weights`: the policy that looks, an ONNX file; None: what was shown longest ago, in turn.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made = made_with(weights)
    paths = {folder / f"{seed:05d}.npz": seed for seed in seeds}
    missing = files.outdated(paths, made, say)
    if missing:
        with pool_of(workers) as pool:
            jobs = [pool.submit(_record, path, paths[path], weights, made) for path in missing]
            for job in tracked(jobs, name):
                job.result()
    return [*paths]


def made_with(weights: Path | None) -> dict[str, str]:
    """What determines a file, beside its seed."""
    policy = {"policy": file_digest(weights)[:16]} if weights else {"policy": "in turn"}
    return policy | of_code("drivers.scenes.insertion", "operators.acting.rollout", __name__)


def read(paths: Iterable[Path]) -> Arrays:
    """Return the moments (m) of all files in one array a name.

    facts (m, MOST, FACTS), appearance (m, MOST, channels), joints (m, 14) and gains (m, MOST), NaN
    where a window was not tried or is none. Raises `DriverError` for a file that is none of these.
    """
    found: dict[str, list[NDArray[np.generic]]] = {}
    for path in paths:
        read = files.read(path)
        if not {*NAMES, "present"} <= set(read):
            raise DriverError(f"{path}: expected valued windows; record it again")
        for name in (*NAMES, "present"):
            found.setdefault(name, []).append(read[name])
    return {name: np.concatenate(values) for name, values in found.items()}


def valued(seed: int, weights: Path | None) -> Arrays:
    """Return one trial with its valued windows, and how it ended."""
    random = np.random.default_rng([seed, 17])
    network = ActingNetwork(weights) if weights else None
    by_chance = RANDOM[0 if network is None else 1]

    def choose(moment: Moment) -> int:
        if random.random() < by_chance:
            return int(random.integers(len(moment.facts)))
        if network is None:
            return int(moment.facts[:, AGE].argmax())
        return int(network(moment.facts, moment.appearance, moment.joints).argmax())

    trial = Trial(seed, saliency=SALIENCY, association=AssociationSettings())
    try:
        moments = trial.moments(choose, random, every=EVERY, tried=TRIED)
    finally:
        trial.close()
    return packed(moments) | {"reward": np.array(trial.best)}


def packed(moments: list[Valued]) -> Arrays:
    """Return moments as arrays of MOST windows each; `present` tells which are windows."""
    rows, channels = len(moments), moments[0].moment.appearance.shape[1]
    out: Arrays = {
        "facts": np.zeros((rows, MOST, FACTS), np.float32),
        "appearance": np.zeros((rows, MOST, channels), np.float32),
        "joints": np.stack([each.moment.joints for each in moments]),
        "gains": np.full((rows, MOST), np.nan, np.float32),
        "present": np.zeros((rows, MOST), np.bool_),
        "change": np.array([each.change for each in moments], np.float32),
    }
    for row, each in enumerate(moments):
        count = min(len(each.gains), MOST)
        out["facts"][row, :count] = each.moment.facts[:count]
        out["appearance"][row, :count] = each.moment.appearance[:count]
        out["gains"][row, :count] = each.gains[:count]
        out["present"][row, :count] = True
    return out


def _record(path: Path, seed: int, weights: Path | None, made: Identity) -> None:
    cv2.setNumThreads(1)
    files.write(path, valued(seed, weights), made)
