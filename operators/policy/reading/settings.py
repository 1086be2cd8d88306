"""Settings of the training of the policy that reads."""

from dataclasses import dataclass, field
from pathlib import Path

from operators.policy.reading.tokens import PARTS
from operators.policy.rollout import Late
from operators.training.ranges import above_zero, at_least, known_device
from pipeline.errors import SettingsError
from pipeline.graph.shipped import TASKS

GRAPH = TASKS / "text_recording.yaml"
TRAIN_SEEDS, VALIDATION_SEEDS = 0, 9_000  # within 0 to 9,999; others are for tables


@dataclass(frozen=True, kw_only=True)
class ReadingTrainSettings:
    """One training run; the defaults are the paper's where it gives them."""

    data: Path
    out: Path
    clips: int = 100
    validation: int = 16
    frames: int = 90
    iterations: int = 3000
    batch: int = 128
    rate: float = 1e-4
    warmup: float = 0.1  # share of the iterations
    decay: float = 0.01
    temperature: float = 0.1
    imitation: float = 0.5  # weight of the cross-entropy beside the expected utility
    episodes: int = 200  # a round
    length: int = 64  # frames of an episode
    checks: int = 48  # episodes on the clips to check on, after each round and at the end
    keep: float = 0.5  # share of the moments that are learned from
    late: Late = field(default_factory=Late)
    scales: tuple[float, ...] = (1.0, 0.5)  # sides of the ROI, of that of the recordings
    seed: int = 1
    threads: int = 1
    device: str = "auto"  # of the network; clips are recorded on the CPU
    use: tuple[str, ...] = PARTS
    changes: tuple[str, ...] = ()  # of the recording graph, as --set takes them

    def __post_init__(self) -> None:
        at_least(1, self, "clips", "validation", "iterations", "batch", "episodes", "checks")
        at_least(1, self, "threads")
        at_least(2, self, "frames", "length")  # the first one is not the policy's
        at_least(0, self, "decay", "imitation", "seed", "warmup")
        above_zero(self, "rate", "temperature", "keep")
        for name in ("warmup", "keep"):
            if getattr(self, name) > 1:
                raise SettingsError(f"{name}: must be within 0..1, got {getattr(self, name)}")
        if not self.scales or not all(0.05 <= scale <= 1 for scale in self.scales):
            raise SettingsError(f"scales: expected some of .05 to 1, got {self.scales}")
        known_device(self.device)
