"""Find objects in a large context where something moved: Frame -> Detections.

The context of a fixed camera that shows a whole pitch has people of 17 pixels: shrunk to a
detector's input they are gone, and read whole it takes a detector ten times as long. Here tiles of
it are looked at one by one, at full resolution, where the picture differs from what it was when
that tile was last looked at. What was found in the other tiles is reported again: nothing there
moved. Of a moving camera everything changes, and each tile has its turn.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.saliency.decode import Candidates, suppress
from operators.saliency.detector import FEATURE_STRIDE_PX, Detector
from operators.saliency.difference import FrameDifference
from operators.saliency.letterbox import Placement
from operators.saliency.roi_align import roi_align
from operators.saliency.saliency import Saliency, SaliencySettings, answer, nothing, rgb, to_sensor
from operators.saliency.tiles import Changes, Grid, grid
from pipeline import Detections, Frame, Header, Input, Operator, SettingsError
from pipeline.boxes import centres

Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class MovedSaliencySettings(SaliencySettings):
    """What a graph may set; a tile has the size of the network's input."""

    tiles: int = 8  # most that are looked at in one frame
    overlap_px: int = 48  # of neighbouring tiles, context pixels: no less than people measure
    change_levels: float = 12.0  # of 255: a smaller difference of 4x4 pixels is noise
    refresh_frames: int = 100  # a tile without change is looked at again after as many

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("tiles", "refresh_frames"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.overlap_px <= 256:
            raise SettingsError(f"overlap_px: must be within 0..256, got {self.overlap_px}")
        if not 0 < self.change_levels < 255:
            raise SettingsError(
                f"change_levels: must be above 0 and below 255, got {self.change_levels:g}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What a tile showed when it was last looked at."""

    found: Candidates  # boxes in context pixels
    features: Array  # (n, C)


class MovedSaliency(Operator[MovedSaliencySettings, Detections]):
    """One answer per frame, boxes in sensor pixels, of all tiles as they were last seen."""

    frame = Input(Frame, keep="latest")

    @classmethod
    def advise(cls, settings: MovedSaliencySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """As `Saliency` does; raises `SettingsError` for an overlap that leaves nothing new."""
        if settings.overlap_px >= min(settings.detector.size_px):
            raise SettingsError(
                f"overlap_px: must be below the sides of a tile, {settings.detector.size_px}, "
                f"got {settings.overlap_px}"
            )
        return Saliency.advise(settings, upstream)

    def open(self) -> None:
        self._detector = Detector(self.settings)
        self._shape: tuple[int, ...] = ()
        self._before = FrameDifference(fixed=True)
        self._window: tuple[int, ...] = ()

    def on_stream(self, header: Header) -> None:
        """Forget all tiles: another stream shows something else."""
        self._shape = ()
        self._before.forget()

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on."""
        return self._detector.network.where()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._detector.network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._detector.network.provider

    def state(self) -> None:
        """Nothing must survive: a successor looks at all tiles within a few frames."""

    def on_frame(self, frame: Frame) -> Detections:
        if not frame.pixels.size:
            return answer(frame, nothing(), np.zeros((0, 0), np.float32), self._detector)
        picture = rgb(frame)
        if frame.window != self._window:
            self._before.forget()
            self._window = frame.window
        if picture.shape != self._shape:
            self._arrange(picture)
        difference = self._before.of(picture) if self._detector.reads_difference else None
        due = self._changes.due(picture, self.settings.tiles, self.settings.refresh_frames)
        for tile in due:
            self._seen[tile] = look(self._detector, picture, difference, self._tiles, tile)
            self._changes.looked(tile)
        found, features = together(self._seen, self.settings, self._detector.channels)
        whole = Placement(
            gain=1.0, left_px=0, top_px=0, width_px=picture.shape[1], height_px=picture.shape[0]
        )
        return answer(frame, to_sensor(found, whole, frame), features, self._detector)

    def _arrange(self, picture: NDArray[np.uint8]) -> None:
        self._shape = picture.shape
        self._tiles = grid(
            picture.shape[1], picture.shape[0], self._detector.size_px, self.settings.overlap_px
        )
        self._changes = Changes(self._tiles, levels=self.settings.change_levels)
        self._seen: dict[int, Seen] = {}


def look(
    detector: Detector, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None,
    tiles: Grid, tile: int,
) -> Seen:  # fmt: skip
    """What a tile shows of the part that it owns; `difference` as `Detector.look` takes it."""
    left, top, right, bottom = tiles.windows[tile]
    part = np.ascontiguousarray(picture[top:bottom, left:right])
    changed = None if difference is None else difference[top:bottom, left:right]
    found, at, features = detector.look(part, changed)
    appearance = np.zeros((len(found.scores), 0), np.float32)
    if features is not None:
        appearance = roi_align(features, found.boxes, stride_px=FEATURE_STRIDE_PX)
    offset = np.array([at.left_px, at.top_px] * 2, np.float32)
    boxes = (found.boxes - offset) / np.float32(at.gain) + np.array([left, top] * 2, np.float32)
    own = tiles.cores[tile]
    middle = centres(boxes)
    kept = np.flatnonzero(((middle >= own[:2]) & (middle < own[2:])).all(1))
    return Seen(found=replace(found, boxes=boxes).take(kept), features=appearance[kept])


def together(
    seen: Mapping[int, Seen], settings: SaliencySettings, channels: int
) -> tuple[Candidates, Array]:
    """What all tiles showed, best first; what two found on both sides of a border counts once."""
    if not seen:
        return nothing(), np.zeros((0, channels), np.float32)
    parts = [item.found for item in seen.values()]
    whole = Candidates(
        boxes=np.concatenate([part.boxes for part in parts]),
        angles=np.concatenate([part.angles for part in parts]),
        scores=np.concatenate([part.scores for part in parts]),
        classes=np.concatenate([part.classes for part in parts]),
    )
    features = np.concatenate([item.features for item in seen.values()])
    order = np.argsort(-whole.scores, kind="stable")
    kept = suppress(whole.take(order), settings.nms_iou, agnostic=settings.class_agnostic)
    rows = order[kept[: settings.max_objects]]
    return whole.take(rows), features[rows]
