"""Print what gym-aloha's own task makes of a trial: seed and steps in, state and reward out.

A process of its own, because dm_control chooses a renderer for the whole process.
"""

import json
import sys

import numpy as np
from dm_control import mujoco
from gym_aloha.constants import ASSETS_DIR
from gym_aloha.tasks import sim
from gym_aloha.utils import sample_insertion_pose

from drivers.scenes.insertion import demonstration

if __name__ == "__main__":
    seed, steps = map(int, sys.argv[1:])
    physics = mujoco.Physics.from_xml_path(str(ASSETS_DIR / "bimanual_viperx_insertion.xml"))
    task = sim.InsertionTask()
    sim.BOX_POSE[0] = np.concatenate(sample_insertion_pose(seed))
    task.initialize_episode(physics)
    for target in demonstration(seed)[:steps]:
        task.before_step(target, physics)
        physics.step(10)
    found = {
        "positions": physics.data.qpos.tolist(),
        "joints": task.get_qpos(physics).tolist(),
        "velocities": task.get_qvel(physics).tolist(),
        "reward": task.get_reward(physics),
    }
    print(json.dumps(found))
