"""Settings of the encoder's training."""

from dataclasses import dataclass
from pathlib import Path

from operators.training.ranges import above_zero, at_least, known_device
from pipeline.errors import SettingsError

OF_SCENE = 24  # crops of one scene in a batch


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: Path
    out: Path
    stills: tuple[Path, ...] = ()  # folders of labelled stills, beside the scenes
    stills_share: float = 0.35  # of the scenes of a batch, where there are stills
    scenes: int = 150
    moments: int = 10
    span: int = 900  # frames of each scene over which its moments are spread
    steps: int = 2000
    batch: int = 120
    rate: float = 2e-3
    warmup: int = 100
    decay: float = 0.02
    identity: float = 1.0  # weight of the second objective
    seed: int = 1
    threads: int = 2
    minutes: float = 30.0
    init: Path | None = None  # ImageNet weights to begin with
    head_of: Path | None = None  # checkpoint whose features are kept
    device: str = "auto"  # where the network is; crops are drawn on processors

    def __post_init__(self) -> None:
        at_least(OF_SCENE, self, "batch")
        at_least(2, self, "moments")  # nobody is known again who was seen once
        at_least(1, self, "span", "steps", "threads")
        at_least(0, self, "warmup", "decay", "identity", "seed")
        above_zero(self, "rate", "minutes")
        if not 0 <= self.stills_share <= 1:
            raise SettingsError(f"stills_share: must be within 0..1, got {self.stills_share}")
        if self.scenes < self.batch // OF_SCENE:
            raise SettingsError(
                f"scenes: a batch of {self.batch} needs at least {self.batch // OF_SCENE}, "
                f"got {self.scenes}"
            )
        known_device(self.device)
