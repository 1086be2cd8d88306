"""Settings of the template tracker's training."""

from dataclasses import dataclass
from pathlib import Path

from operators.training.ranges import above_zero, at_least, known_device


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: Path  # drawn and cut pieces, made if missing
    out: Path
    stills: tuple[Path, ...] = ()  # folders of pictures, and videos
    scenes: int = 24
    moments: int = 6  # of a scene
    steps: int = 30_000
    batch: int = 32
    reuses: int = 0  # steps on old batches after each new one, where a GPU waits for samples
    rate: float = 1e-3
    warmup: int = 200
    decay: float = 0.02
    seed: int = 1
    threads: int = 1
    minutes: float = 600.0
    device: str = "auto"  # where the network is; samples are made on processors

    def __post_init__(self) -> None:
        at_least(2, self, "batch")  # a batch norm needs two
        at_least(1, self, "scenes", "moments", "steps", "threads")
        at_least(0, self, "reuses", "warmup", "decay", "seed")
        above_zero(self, "rate", "minutes")
        known_device(self.device)
