"""The insertion task: joint targets in, the state of both arms and the task's reward out.

As `gym_aloha/AlohaInsertion-v0`: two ViperX arms, a peg and a socket on a table; the right arm
takes the peg, the left one the socket, and the peg goes into the socket in mid-air.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.insertion.physics import Camera, Physics

JOINTS = 14  # six joints and a gripper (0 closed .. 1 open) of the left arm, then of the right
COMPLETE, PARTIAL = 4, 3  # rewards: inserted; peg and socket touch in mid-air
STEPS = 400  # of one trial, 8 s
CLOSED_M, OPEN_M = 0.01844, 0.058  # of a finger from the middle
REST = np.array([0, -0.96, 1.16, 0, -0.3, 0, 0.02239, -0.02239] * 2)
SOCKET = ("socket-1", "socket-2", "socket-3", "socket-4")
FINGER = "vx300s_{0}/10_{0}_gripper_finger"
TABLE, PEG, PIN = "table", "red_peg", "pin"
MODEL = "bimanual_viperx_insertion"
VIEW = "top"  # the camera of ALOHA's pictures
# of peg and socket at the start, metres: lowest and highest (x, y, z)
PEG_RANGE = (0.1, 0.4, 0.05), (0.2, 0.6, 0.05)
SOCKET_RANGE = (-0.2, 0.4, 0.05), (-0.1, 0.6, 0.05)


def resting() -> NDArray[np.float32]:
    """Return the joints (14,) at the start of every trial."""
    return joints_of(np.concatenate([REST, start_of(0)]))


def start_of(seed: int) -> NDArray[np.float64]:
    """Return the poses (14,) of peg and socket in the trial of a seed, the same as gym-aloha's."""
    random = np.random.RandomState(seed)  # for the numbers of gym-aloha
    upright = [1.0, 0.0, 0.0, 0.0]
    peg, socket = (random.uniform(*limits) for limits in (PEG_RANGE, SOCKET_RANGE))
    return np.concatenate([peg, upright, socket, upright])


class Simulation:
    """One trial from the start of a seed; the same targets always give the same states."""

    def __init__(self, seed: int) -> None:
        self.physics = Physics(MODEL)
        self._camera: Camera | None = None
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Begin the trial of a seed."""
        self.physics.reset(np.concatenate([REST, start_of(seed)]), REST)
        self.best = 0  # reward so far

    def step(self, targets: NDArray[np.float32]) -> int:
        """Hold joint targets (14,) for one period of control; return the reward 0..4."""
        self.physics.step(controls_of(targets))
        reward = reward_of(self.physics.contacts())
        self.best = max(self.best, reward)
        return reward

    def joints(self) -> NDArray[np.float32]:
        """Positions (14,) of the joints, radians, grippers 0..1."""
        return joints_of(self.physics.positions)

    def picture(self) -> NDArray[np.uint8]:
        """The workplace from above, (480, 640, 3) RGB, valid until the next call.

        The first call opens the renderer; later ones must be made by the same thread. Raises
        `DriverError` where nothing can be drawn.
        """
        if self._camera is None:
            self._camera = Camera(self.physics, VIEW)
        return self._camera.picture()

    def close(self) -> None:
        """Release the renderer."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def velocities(self) -> NDArray[np.float32]:
        """Velocities (14,) of the joints, per second."""
        seen = self.physics.velocities
        left, right = seen[:7].copy(), seen[8:15].copy()
        left[6] /= OPEN_M - CLOSED_M
        right[6] /= OPEN_M - CLOSED_M
        return np.concatenate([left, right]).astype(np.float32)


def controls_of(targets: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the commands (16,) of the actuators: a gripper has two fingers."""
    controls = np.empty(16)
    for arm in range(2):
        given = np.asarray(targets[7 * arm : 7 * arm + 7], np.float64)
        finger = CLOSED_M + given[6] * (OPEN_M - CLOSED_M)
        controls[8 * arm : 8 * arm + 8] = *given[:6], finger, -finger
    return controls


def joints_of(positions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the joints (14,) of the simulation's positions.

    >>> [f"{joint:.2f}" for joint in joints_of(np.concatenate([REST, start_of(0)]))[[1, 6, 8]]]
    ['-0.96', '0.10', '-0.96']
    """
    left, right = positions[:7].copy(), positions[8:15].copy()
    for arm in (left, right):
        arm[6] = (arm[6] - CLOSED_M) / (OPEN_M - CLOSED_M)
    return np.concatenate([left, right]).astype(np.float32)


def reward_of(contacts: set[frozenset[str]]) -> int:
    """Return the stage that the touching shapes show, 0..4, by gym-aloha's rules.

    1: both arms touch their object; 2: and hold it in the air; 3: peg and socket touch in the air;
    4: the peg touches the pin inside the socket.
    """

    def touch(one: str, *others: str) -> bool:
        return any(frozenset((one, other)) in contacts for other in others)

    held = touch(FINGER.format("left"), *SOCKET) and touch(FINGER.format("right"), PEG)
    in_air = not touch(TABLE, PEG, *SOCKET)
    if touch(PIN, PEG):
        return COMPLETE
    if touch(PEG, *SOCKET) and in_air:
        return PARTIAL
    return 2 if held and in_air else int(held)
