"""Settings of the detector's training."""

from dataclasses import dataclass
from pathlib import Path

from operators.saliency.example import INPUT_PX, MULTIPLE_PX
from operators.training.ranges import above_zero, at_least, known_device
from operators.training.splits import HELD_OUT
from pipeline.errors import SettingsError

# parts of the network that can be trained alone; `balls` are both heads for one
HEADS = ("ball", "moving", "balls")
LEAST_PX = 256  # in a smaller input a ball of a ROI is hardly larger than in a context
MOST_PX = 2048  # a batch of larger pictures would not fit into memory


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """One training run."""

    data: tuple[Path, ...]
    out: Path
    stills: tuple[Path, ...] = ()  # folders of labelled stills
    leave_out: tuple[str, ...] = HELD_OUT  # beginnings of names of stills that are not trained on
    stills_share: float = 0.65  # of the pictures of a batch, where there are stills
    width_px: int = INPUT_PX[0]  # of the input that pictures are enlarged to
    also_px: int = 0  # width of every second batch; 0: the same
    scenes: int = 320
    moments: int = 12
    span: int = 900  # frames of each scene over which its moments are spread
    rois: int = 0  # parts of each moment, beside its context, at a ROI's scale in 480 pixels
    steps: int = 4800
    batch: int = 16
    rate: float = 2e-3
    warmup: int = 300
    decay: float = 0.02
    seed: int = 1
    threads: int = 2
    minutes: float = 120.0
    compiled: bool = False
    difference: bool = False  # add a head for a moving ball that gets what changed
    only: str = ""  # one of HEADS, which is trained while all else stays; empty: everything
    raw_share: float = 0.0  # share of the pictures that are seen through a raw sensor
    roi_share: float = 0.0  # share of the stills' pictures that show what a ROI does
    init: Path | None = None  # checkpoint or .onnx to begin with instead of random weights
    device: str = "auto"  # where the network is; scenes are drawn on processors

    def __post_init__(self) -> None:
        at_least(1, self, "moments", "span", "steps", "batch", "threads")
        for name, width in zip(("width_px", "also_px"), self.widths_px, strict=False):
            if width % MULTIPLE_PX:
                raise SettingsError(f"{name}: must be a multiple of {MULTIPLE_PX}, got {width}")
            if not LEAST_PX <= width <= MOST_PX:
                none = "0 or " if name == "also_px" else ""
                said = f"{name}: must be {none}within {LEAST_PX}..{MOST_PX}, got {width}"
                raise SettingsError(said)
        # no scenes: other data alone
        at_least(0, self, "scenes", "rois", "warmup", "decay", "seed")
        above_zero(self, "rate", "minutes")
        for name in ("raw_share", "roi_share", "stills_share"):
            if not 0 <= (share := getattr(self, name)) <= 1:
                raise SettingsError(f"{name}: must be within 0..1, got {share}")
        known_device(self.device)
        if self.roi_share and not self.stills:
            raise SettingsError("roi_share: expected stills as well, got none")
        if self.rois and not self.scenes:
            raise SettingsError("rois: expected scenes as well, got none")
        for name in ("roi_share", "rois"):
            if getattr(self, name) and self.difference:  # a ROI has no frame before it
                raise SettingsError(f"{name}: expected no difference, got one")
        if self.only not in ("", *HEADS):
            raise SettingsError(f"only: expected one of {', '.join(HEADS)}, got {self.only[:40]!r}")
        if self.only in ("moving", "balls") and not self.difference:
            raise SettingsError("only: expected a difference for the moving head, got none")
        if self.only and not self.init:
            raise SettingsError("only: expected weights to begin with (init) as well, got none")

    @property
    def widths_px(self) -> tuple[int, ...]:
        """Widths that batches have in turn."""
        return (self.width_px, self.also_px) if self.also_px else (self.width_px,)
