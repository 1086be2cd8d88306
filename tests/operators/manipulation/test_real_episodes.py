"""The scripted expert against the recorded episodes of ALOHA's simulation."""

from importlib.util import find_spec

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.shared_data import Footage

ALIKE = [1, 2, 4, 6, 8, 9, 11, 13]  # the other joints turn to where things lie in the trial

pytestmark = [
    pytest.mark.footage,
    pytest.mark.skipif(
        not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
    ),
]


def actions(footage: Footage, kind: str) -> NDArray[np.float32]:
    with np.load(footage.data("aloha") / f"{kind}_episode0.npz") as read:
        return np.asarray(read["action"], np.float32)


def test_the_expert_moves_as_the_scripted_episode_does(footage: Footage) -> None:
    from drivers.scenes.insertion import demonstration

    real = actions(footage, "scripted")
    mean = np.mean([demonstration(seed) for seed in range(80_000, 80_020)], 0)

    assert mean.shape == real.shape
    alike = [float(np.corrcoef(mean[:, joint], real[:, joint])[0, 1]) for joint in ALIKE]
    assert min(alike) > 0.7
    assert min(alike[3], alike[7]) > 0.99  # the grippers open and close in the same steps


def test_people_keep_to_the_limits_that_the_simulation_has(footage: Footage) -> None:
    human = actions(footage, "human")

    assert human.shape == (500, 14)
    assert np.abs(human[:, [j for j in range(14) if j not in (6, 13)]]).max() < 1.9
    assert -0.1 < human[:, [6, 13]].min() <= human[:, [6, 13]].max() < 1.3
