"""The insertion task: the same states as gym-aloha, an expert that inserts, truth, refusals."""

import json
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.scenes.insertion.simulation import controls_of, joints_of, reward_of, start_of
from pipeline.errors import DriverError, SettingsError

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
)
LEFT, RIGHT = "vx300s_left/10_left_gripper_finger", "vx300s_right/10_right_gripper_finger"
HELD = [(LEFT, "socket-1"), (RIGHT, "red_peg")]


@pytest.mark.parametrize(
    ("touching", "reward"),
    [
        ([], 0),
        ([(LEFT, "socket-3"), ("red_peg", "table")], 0),
        ([*HELD, ("red_peg", "table")], 1),
        (HELD, 2),
        ([*HELD, ("red_peg", "socket-2")], 3),
        ([("red_peg", "socket-2"), ("table", "socket-2")], 0),
        ([*HELD, ("pin", "red_peg")], 4),
    ],
)
def test_the_reward_tells_the_stage_by_what_touches(
    touching: list[tuple[str, str]], reward: int
) -> None:
    assert reward_of({frozenset(pair) for pair in touching}) == reward


@given(st.integers(0, 2**32 - 1))
def test_peg_and_socket_lie_on_their_own_sides_of_the_table(seed: int) -> None:
    start = start_of(seed)

    assert 0.1 <= start[0] <= 0.2
    assert -0.2 <= start[7] <= -0.1
    assert all(0.4 <= y <= 0.6 for y in start[[1, 8]])


@given(st.lists(st.floats(-1, 1, width=32), min_size=14, max_size=14))
def test_commands_hold_the_joints_that_were_asked_for(values: list[float]) -> None:
    targets = np.array(values, np.float32)

    np.testing.assert_allclose(joints_of(controls_of(targets)), targets, atol=1e-5)


@needs_robot
def test_trials_begin_and_go_on_as_gym_aloha_has_them() -> None:
    pytest.importorskip("dm_control")
    from drivers.scenes.insertion import Simulation, demonstration

    steps, ours = 200, Simulation(7)
    for target in demonstration(7)[:steps]:
        reward = ours.step(target)
    command = [sys.executable, "-m", "tests.drivers.scenes.gym_aloha_states", "7", str(steps)]
    theirs = json.loads(subprocess.check_output(command, timeout=60))

    np.testing.assert_allclose(ours.physics.positions, theirs["positions"], atol=1e-6)
    np.testing.assert_allclose(ours.joints(), theirs["joints"], atol=1e-5)
    np.testing.assert_allclose(ours.velocities(), theirs["velocities"], atol=1e-3)
    assert reward == theirs["reward"]


def inserted(seed: int) -> bool:
    from drivers.scenes.insertion import COMPLETE, Simulation, demonstration

    simulation = Simulation(seed)
    return any(simulation.step(target) == COMPLETE for target in demonstration(seed))


@needs_robot
def test_the_expert_inserts_the_peg() -> None:
    assert inserted(80_001)


@needs_robot
@pytest.mark.slow
def test_the_expert_inserts_the_peg_in_all_of_fifty_trials() -> None:
    assert [seed for seed in range(50) if not inserted(seed)] == []


@needs_robot
def test_the_boxes_of_the_truth_are_where_the_objects_are_seen() -> None:
    from drivers.scenes import InsertionScene

    scene = InsertionScene(seed=80_002)
    red, green, blue = np.moveaxis(scene.picture(0).astype(int), 2, 0)
    truth = scene.truth(0)
    scene.close()

    assert truth is not None
    for label, seen in (("peg", red - green > 90), ("socket", blue - green > 90)):
        rows, columns = np.nonzero(seen)
        corners = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        np.testing.assert_allclose(truth.boxes[truth.labels.index(label)], corners, atol=2)


@needs_robot
def test_targets_move_the_arms_from_their_frame_on_and_are_held_after_the_last() -> None:
    from drivers.scenes import InsertionScene

    scene, again = InsertionScene(seed=1), InsertionScene(seed=1)
    targets = np.tile(scene.joints()[0], (3, 1))
    targets[:, 0] = 0.2
    for each in (scene, again):
        each.act(5, targets)

    scene.picture(4)
    still = scene.joints()[0][0]
    pictures = [each.picture(60).copy() for each in (scene, again)]

    assert abs(still) < 0.01
    assert abs(scene.joints()[0][0] - 0.2) < 0.02
    np.testing.assert_array_equal(*pictures)
    for each in (scene, again):
        each.close()


@needs_robot
def test_a_simulation_does_not_go_back_and_ends() -> None:
    from drivers.scenes import InsertionScene

    scene = InsertionScene(seed=1, length=9)
    scene.picture(3)

    with pytest.raises(DriverError, match="cannot go back"):
        scene.picture(2)
    with pytest.raises(IndexError):
        scene.picture(9)
    scene.close()


@needs_robot
def test_wrong_targets_and_settings_are_refused() -> None:
    from drivers.scenes import InsertionScene

    scene = InsertionScene(seed=1)
    for targets in (np.zeros((2, 13), np.float32), np.full((1, 14), np.nan, np.float32)):
        with pytest.raises(DriverError, match="expected"):
            scene.act(0, targets)
    for wrong in ({"size_px": (320, 240)}, {"rate_hz": 30.0}, {"seed": -1}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            InsertionScene(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("missing", ["mujoco", "gym_aloha"])
def test_a_missing_package_is_one_sentence_with_what_to_install(missing: str) -> None:
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from drivers.scenes import InsertionScene\nInsertionScene(seed=1)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)

    assert found.returncode == 1
    assert found.stderr.rstrip().endswith("pip install 'fovea[robot]'")


@needs_robot
def test_a_system_without_a_renderer_is_one_sentence_with_what_to_install() -> None:
    code = (
        "import sys; sys.modules['mujoco.osmesa'] = sys.modules['mujoco.egl'] = None\n"
        "from drivers.scenes import InsertionScene\nInsertionScene(seed=1).picture(0)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)

    assert "DriverError: insertion: " in found.stderr
    assert "apt install libosmesa6" in found.stderr
