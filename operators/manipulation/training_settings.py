"""Settings of the consumer's training."""

from dataclasses import dataclass
from pathlib import Path

from operators.training.ranges import above_zero, at_least, known_device


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: Path
    out: Path
    demonstrations: int = 900
    frames: int = 32  # pictures of a demonstration
    iterations: int = 8000
    batch: int = 64
    rate: float = 5e-4
    warmup: float = 0.05  # share of the iterations
    decay: float = 0.0001
    chunk: int = 100  # steps that the network tells at once
    noise: float = 0.05  # radians, of the joints that the network is given, for the same reason
    # as the disturbance of demonstrations
    divergence: float = 0.01  # weight of the Kullback-Leibler divergence of the styles
    trials: int = 20  # closed-loop trials after the training
    guide: float = 2.0  # weight of looking at peg and socket, where that is known
    init: Path | None = None  # a checkpoint of a network to begin with
    seed: int = 1
    threads: int = 2
    device: str = "auto"

    def __post_init__(self) -> None:
        at_least(1, self, "demonstrations", "frames", "iterations", "batch", "chunk", "threads")
        at_least(0, self, "warmup", "decay", "noise", "guide", "divergence", "trials", "seed")
        above_zero(self, "rate")
        known_device(self.device)
