"""Settings of the training of the policy that acts."""

from dataclasses import dataclass
from pathlib import Path

from operators.training.ranges import above_zero, at_least, known_device


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: Path
    out: Path
    trials: int = 20  # of each of the two rounds
    iterations: int = 10_000  # of each round
    batch: int = 64  # moments
    rate: float = 1e-3
    warmup: float = 0.1  # share of the iterations
    decay: float = 0.01
    seed: int = 1
    threads: int = 1
    device: str = "auto"

    def __post_init__(self) -> None:
        at_least(1, self, "trials", "iterations", "batch", "threads")
        at_least(0, self, "warmup", "decay", "seed")
        above_zero(self, "rate")
        known_device(self.device)
