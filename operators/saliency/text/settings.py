"""Settings of the text detector's training."""

from dataclasses import dataclass
from pathlib import Path

from operators.training.ranges import above_zero, at_least, known_device
from pipeline.errors import SettingsError

TRAIN_SEEDS = 10_000  # clips from here on are not for training


@dataclass(frozen=True, kw_only=True)
class TextTrainSettings:
    """One training run."""

    data: Path  # folder for drawn pictures
    out: Path
    stills: Path | None = None  # folder of photographs to draw upon
    streets: int = 110  # parts of drawn streets
    clips: int = 110  # drawn drives, of seeds from 0 on
    clips_share: float = 0.6  # of the pictures of a batch
    steps: int = 4200
    batch: int = 16
    rate: float = 2e-3
    warmup: int = 200
    decay: float = 0.02
    seed: int = 1
    threads: int = 1
    minutes: float = 120.0
    compiled: bool = False
    init: Path | None = None  # checkpoint of a text detector, or the shipped detector's .onnx
    device: str = "auto"  # where the network is; pictures are drawn on processors

    def __post_init__(self) -> None:
        at_least(1, self, "streets", "steps", "batch", "threads")
        at_least(0, self, "clips", "warmup", "decay", "seed")
        above_zero(self, "rate", "minutes")
        known_device(self.device)
        if self.clips > TRAIN_SEEDS:
            raise SettingsError(f"clips: expected up to {TRAIN_SEEDS}, got {self.clips}")
        if not 0 < self.clips_share < 1:
            raise SettingsError(f"clips_share: must be between 0 and 1, got {self.clips_share}")
        if self.stills is not None and not self.stills.is_dir():
            raise SettingsError(f"stills: expected a folder, got {self.stills}")
