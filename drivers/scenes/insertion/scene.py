"""The insertion task as a source of pictures: joint targets in, pictures, truth and reward out."""

import threading

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.insertion.physics import RATE_HZ, SIZE_PX
from drivers.scenes.insertion.simulation import (
    COMPLETE,
    JOINTS,
    PEG,
    SOCKET,
    STEPS,
    VIEW,
    Simulation,
    resting,
)
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

LABELS = ("peg", "socket", "left gripper", "right gripper")
SHAPES = (  # in the order of their labels
    (PEG,),
    SOCKET,
    *(
        tuple(f"vx300s_{side}/10_{end}_gripper_finger" for end in ("left", "right"))
        for side in ("left", "right")
    ),
)
STAGES = (
    "nothing was taken",
    "both objects were touched",
    "both objects were held in the air",
    "peg and socket touched",
    "the peg was inserted",
)


class InsertionScene:
    """A `World` of one trial, by seed: 640x480 at 50 Hz. Frame k shows the state after k steps."""

    shows = "manipulation"

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = SIZE_PX,
        rate_hz: float = RATE_HZ,
        seed: int = 0,
        length: int | None = STEPS,
    ) -> None:
        if tuple(size_px) != SIZE_PX:
            raise SettingsError(f"size_px: the insertion scene has {SIZE_PX}, got {size_px}")
        if rate_hz != RATE_HZ:
            raise SettingsError(f"rate_hz: the insertion scene has {RATE_HZ:g}, got {rate_hz:g}")
        if seed < 0:
            raise SettingsError(f"seed: must be at least 0, got {seed}")
        self.size_px, self.rate_hz = SIZE_PX, RATE_HZ
        self.length: int | None = STEPS if length is None else length
        self._simulation = Simulation(seed)
        self._lock = threading.Lock()
        self._step = 0
        self._first, self._targets = 0, resting()[None]
        self._held = self._targets[0]
        self._inserted_at = -1

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Advance to step `index` and return its picture, valid until the next call."""
        if not 0 <= index < (self.length or 0):
            raise IndexError(f"insertion: no frame {index} in {self.length}")
        if index < self._step:
            raise DriverError(
                f"insertion: frame {index} was asked for after {self._step}: a simulation cannot "
                "go back"
            )
        while self._step < index:
            self._advance()
        return self._simulation.picture()

    def truth(self, index: int) -> Annotations:
        """Boxes of peg, socket and grippers in the last picture."""
        physics = self._simulation.physics
        corners = [physics.corners(shapes) for shapes in SHAPES]
        return Annotations(
            boxes=np.stack([_box(physics.projected(each, VIEW)) for each in corners]),
            ids=np.arange(len(LABELS), dtype=np.int32),
            labels=LABELS,
            visibility=np.ones(len(LABELS), np.float32),
        )

    def act(self, first: int, targets: NDArray[np.float32]) -> None:
        """Hold row i of the targets (T, 14) from step `first` + i to the next."""
        if targets.ndim != 2 or targets.shape[1] != JOINTS:
            raise DriverError(
                f"insertion: expected targets of {JOINTS} joints, got {list(targets.shape)}"
            )
        if not np.isfinite(targets).all():
            raise DriverError("insertion: expected finite targets, got others")
        with self._lock:
            self._first, self._targets = first, np.array(targets)

    def joints(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions and velocities (14,) in the last picture."""
        return self._simulation.joints(), self._simulation.velocities()

    def outcome(self) -> tuple[int, str]:
        """The best reward so far, 0..4, and what it means."""
        best = self._simulation.best
        when = f" after {self._inserted_at / RATE_HZ:.1f} s" if self._inserted_at >= 0 else ""
        return best, f"{STAGES[best]}{when} ({best} of {COMPLETE})"

    def close(self) -> None:
        """Release the renderer."""
        self._simulation.close()

    def _advance(self) -> None:
        with self._lock:
            row = self._step - self._first
            if row >= 0 and len(self._targets):
                self._held = self._targets[min(row, len(self._targets) - 1)]
        self._step += 1
        reward = self._simulation.step(self._held)
        if reward == COMPLETE and self._inserted_at < 0:
            self._inserted_at = self._step


def _box(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """The box (4,) around points (n, 2), inside the picture."""
    limits = np.array(SIZE_PX)
    low, high = np.clip(points.min(0), 0, limits), np.clip(points.max(0), 0, limits)
    return np.concatenate([low, high]).astype(np.float32)
