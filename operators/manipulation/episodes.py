"""Write scripted demonstrations as ALOHA episodes: seeds of trials in, HDF5 files out.

python -m operators.manipulation.episodes --seeds 0-9 FOLDER
"""

# mypy: disallow-untyped-decorators=False
from pathlib import Path

import click
import numpy as np

from drivers.datasets.aloha import write_episode
from drivers.scenes.insertion import JOINTS, STEPS, Simulation, demonstration
from operators.training.command_line import in_a_sentence

CAMERA = "top"
MOST_EPISODES = 10_000


def write(path: Path, seed: int, steps: int = STEPS) -> int:
    """Write the expert's trial of a seed, its first `steps`; return the best reward."""
    targets = demonstration(seed)[:steps]
    simulation = Simulation(seed)
    qpos, qvel = (np.empty((len(targets), JOINTS), np.float32) for _ in range(2))
    pictures = []
    for step, target in enumerate(targets):
        pictures.append(simulation.picture().copy())
        qpos[step], qvel[step] = simulation.joints(), simulation.velocities()
        simulation.step(target)
    simulation.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    shown = {CAMERA: np.stack(pictures)}
    write_episode(path, pictures=shown, qpos=qpos, qvel=qvel, action=targets)
    return simulation.best


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    if not first.isdecimal() or not (last or first).isdecimal() or text.endswith("-"):
        raise click.UsageError(f"--seeds: expected a number or two as 0-9, got {text!r}")
    found = range(int(first), int(last or first) + 1)
    if not 1 <= len(found) <= MOST_EPISODES:
        raise click.UsageError(f"--seeds: expected 1 to {MOST_EPISODES} trials, got {text!r}")
    return found


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("folder", type=Path)
@click.option("--seeds", default="0", show_default=True, help="a seed, or the first and the last")
def command(folder: Path, seeds: str) -> None:
    """Write scripted demonstrations of the insertion task as ALOHA episodes."""
    with in_a_sentence():
        for seed in _seeds(seeds):
            path = folder / f"episode_{seed}.hdf5"
            click.echo(f"{path}: reward {write(path, seed)} of 4")


if __name__ == "__main__":
    command()
