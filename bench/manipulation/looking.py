"""`fovea eval acting`: where the ROI looks, and how far that changes the consumer's actions.

Every rule has the same trials of the frozen consumer at a sixteenth of the pixels. Told is the mean
absolute change of its chunks against full resolution, a figure of each frame and so with far less
noise than success, beside the success.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np

from bench.machine import facts
from bench.manipulation.evaluate import LIBRARIES
from bench.options import writable
from drivers.scenes.insertion import COMPLETE, PARTIAL
from operators.acting.data import SALIENCY
from operators.acting.network import SHIPPED, ActingNetwork
from operators.acting.rollout import Choose, Moment, Trial
from operators.acting.windows import AGE, PLACE, TRACK, in_turn
from operators.association import AssociationSettings
from operators.training.command_line import in_a_sentence
from operators.training.progress import tracked
from pipeline.whole_file import write_whole

EVERY = 5  # frames between those in which the change is measured


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--weights", type=Path, default=SHIPPED, help="of the policy; else the shipped one")
@click.option("--rules", default="turn,gain,chance,tracks", show_default=True)
@click.option("--trials", default=20, show_default=True, type=click.IntRange(1, 10_000))
@click.option("--seed", default=50_400, show_default=True, type=click.IntRange(0))
@click.option(
    "--json", "report", type=click.Path(path_type=Path), callback=writable, help="write the figures"
)
def command(weights: Path, rules: str, trials: int, seed: int, report: Path | None) -> None:
    """See the module."""
    cv2.setNumThreads(1)
    with in_a_sentence():
        found = {}
        for name in rules.split(","):
            choose = rule_of(name, weights, seed)
            seeds = tracked(range(seed, seed + trials), name)
            found[name] = told([tried(each, choose) for each in seeds])
            row = found[name]
            click.echo(
                f"{name}: change {row['change']:.5f} (of trials {row['spread']:.5f}), complete "
                f"{row['complete']:.2f}, partial {row['partial']:.2f}"
            )
    if report:
        what = {**facts(LIBRARIES), "trials": trials, "seed": seed, "every": EVERY, "rules": found}
        write_whole(report, json.dumps(what, indent=1) + os.linesep)


def rule_of(name: str, weights: Path, seed: int) -> Choose:
    """Return what chooses a window; raises `UsageError` for an unknown name."""
    random = np.random.default_rng([seed, 23])
    if name == "gain":
        network = ActingNetwork(weights)
        return lambda m: int(network(m.facts, m.appearance, m.joints).argmax())
    known: Mapping[str, Choose] = {
        "turn": lambda m: in_turn(m.candidates, m.step + 1),
        "tracks": lambda m: _oldest(m, TRACK if (m.candidates.kinds == TRACK).any() else PLACE),
        "chance": lambda m: int(random.integers(len(m.facts))),
    }
    if name not in known:
        raise click.UsageError(f"--rules: expected some of gain, {', '.join(known)}, got {name}")
    return known[name]


def _oldest(moment: Moment, kind: int) -> int:
    return int(np.where(moment.candidates.kinds == kind, moment.facts[:, AGE], -1).argmax())


def tried(seed: int, choose: Choose) -> tuple[int, float]:
    """Return the reward of a trial, and the mean change of its chunks."""
    trial = Trial(seed, saliency=SALIENCY, association=AssociationSettings())
    try:
        found = trial.moments(choose, np.random.default_rng(seed), every=EVERY, tried=0)
    finally:
        trial.close()
    return trial.best, float(np.mean([each.change for each in found]))


def told(trials: list[tuple[int, float]]) -> dict[str, Any]:
    """Return the figures of a rule."""
    rewards, changes = np.array([reward for reward, _ in trials]), [each for _, each in trials]
    return {
        "change": round(float(np.mean(changes)), 6),
        "spread": round(float(np.std(changes)), 6),
        "complete": round(float((rewards >= COMPLETE).mean()), 4),
        "partial": round(float((rewards >= PARTIAL).mean()), 4),
        "changes": [round(each, 6) for each in changes],
        "rewards": rewards.tolist(),
    }


if __name__ == "__main__":
    command()
