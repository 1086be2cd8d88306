"""Scripted demonstrations as ALOHA episodes: written as the data set has them, seeds checked."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from operators.manipulation.episodes import command, write

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha") and find_spec("h5py")),
    reason="needs the robot extra",
)


@needs_robot
def test_an_episode_has_the_experts_actions_and_what_it_saw(tmp_path: Path) -> None:
    from drivers.datasets import AlohaEpisode
    from drivers.scenes.insertion import Simulation, demonstration

    reward = write(tmp_path / "new" / "episode_0.hdf5", 80_005, steps=3)
    read = AlohaEpisode(path=str(tmp_path / "new" / "episode_0.hdf5"))
    simulation = Simulation(80_005)

    assert reward == 0
    assert (read.size_px, read.length, read.simulated) == ((640, 480), 3, True)
    np.testing.assert_array_equal(read.action, demonstration(80_005)[:3])
    np.testing.assert_array_equal(read.picture(0), simulation.picture())
    np.testing.assert_array_equal(read.qpos[0], simulation.joints())
    simulation.close()
    read.close()


@pytest.mark.parametrize("seeds", ["x", "-1", "3-", "5-2", "0-10000"])
def test_seeds_that_are_none_are_refused(tmp_path: Path, seeds: str) -> None:
    found = CliRunner().invoke(command, [str(tmp_path), f"--seeds={seeds}"])

    assert found.exit_code == 2
    assert "--seeds: expected" in found.output
    assert not list(tmp_path.iterdir())
