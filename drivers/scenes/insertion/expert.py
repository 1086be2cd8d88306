"""A scripted expert: the trial's seed in, joint targets that insert the peg out.

It plans poses of both grippers from where peg and socket lie at the start, lets a simulation in
which the grippers are pulled along these poses find the joints, and takes those as targets.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.scenes.insertion.physics import Physics
from drivers.scenes.insertion.simulation import (
    CLOSED_M,
    JOINTS,
    OPEN_M,
    REST,
    STEPS,
    joints_of,
    start_of,
)

MODEL = "bimanual_viperx_end_effector_insertion"
HOME = np.array([[-0.31718881, 0.5, 0.29525084], [0.31718881, 0.49999888, 0.29525084]])
MEET = np.array([0.0, 0.5, 0.15])  # where the socket waits for the peg, metres
PICK_DEGREES = 60  # a gripper looks down by so much when it takes its object
LIFT_M = 0.00715  # of the peg above the socket's gripper


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """Where a gripper is to be at a step: metres, looking down by `down` degrees, 0..1 open."""

    step: int
    place: NDArray[np.float64]  # (3,)
    down: float
    gripper: float


def demonstration(seed: int) -> NDArray[np.float32]:
    """Return the joint targets (400, 14) of the trial of a seed."""
    start = start_of(seed)
    peg, socket = start[:3], start[7:10]
    plans = [_poses(_waypoints(side, place), side) for side, place in ((-1, socket), (1, peg))]
    places = np.stack([plan[0] for plan in plans], 1)  # (steps, 2, 3)
    rotations = np.stack([plan[1] for plan in plans], 1)
    openings = np.stack([plan[2] for plan in plans], 1)
    return _followed(start, places, rotations, openings)


def _waypoints(side: int, place: NDArray[np.float64]) -> list[Waypoint]:
    """Of the left gripper (side -1), which brings the socket, or the right one with the peg."""

    def point(
        step: int, place: NDArray[np.float64], up: float, down: float, gripper: float
    ) -> Waypoint:
        return Waypoint(step=step, place=place + np.array([0, 0, up]), down=down, gripper=gripper)

    away = np.array([side, 0.0, 0.0])
    lift = LIFT_M if side > 0 else 0.0
    return [
        point(0, HOME[int(side > 0)], 0, 0, 0),
        point(120, place, 0.08, PICK_DEGREES, 1),
        point(170, place, -0.03, PICK_DEGREES, 1),
        point(220, place, -0.03, PICK_DEGREES, 0),
        point(285, MEET + 0.1 * away, lift, PICK_DEGREES, 0),
        point(340, MEET + 0.05 * away, lift, PICK_DEGREES, 0),
        point(STEPS, MEET + 0.05 * away, lift, PICK_DEGREES, 0),
    ]


def _poses(
    points: list[Waypoint], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return place (steps, 3), quaternion (steps, 4) and opening (steps,) in every step."""
    times = np.array([point.step for point in points])
    steps = np.arange(1, STEPS + 1)
    place = np.stack(
        [np.interp(steps, times, [p.place[axis] for p in points]) for axis in range(3)], 1
    )
    opening = np.interp(steps, times, [p.gripper for p in points])
    down = np.interp(steps, times, [p.down for p in points])
    turned = Rotation.from_rotvec(np.outer(-side * down, (0, 1, 0)), degrees=True)
    return place, turned.as_quat(scalar_first=True), opening


def _followed(
    start: NDArray[np.float64],
    places: NDArray[np.float64],
    rotations: NDArray[np.float64],
    openings: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return the joints (steps, 14) of arms whose grippers are pulled along poses."""
    physics = Physics(MODEL)
    closed = np.array([CLOSED_M, -CLOSED_M] * 2)
    physics.pull(HOME, np.tile([1.0, 0, 0, 0], (2, 1)))
    physics.reset(np.concatenate([REST, start]), closed)
    targets = np.empty((len(places), JOINTS), np.float32)
    for step, (place, rotation, opening) in enumerate(
        zip(places, rotations, openings, strict=True)
    ):
        physics.pull(place, rotation)
        finger = CLOSED_M + opening * (OPEN_M - CLOSED_M)
        physics.step(np.array([finger[0], -finger[0], finger[1], -finger[1]]))
        targets[step] = joints_of(physics.positions)
        targets[step, [6, 13]] = opening
    return targets
