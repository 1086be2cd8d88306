"""Find objects in a large context where something moved: Frame -> Detections.

The context of a fixed camera that shows a whole pitch has people of 17 pixels: shrunk to a
detector's input they are gone, and read whole it takes a detector ten times as long. Here tiles of
it are looked at one by one, at full resolution, where the picture differs from what it was when
that tile was last looked at. What was found in the other tiles is reported again: nothing there
moved. Of a moving camera everything changes, and each tile has its turn.

Where `roi` is connected, one more tile lies at the latest ROI: what the policy follows is looked at
in every frame, however few tiles there is time for.
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
from operators.saliency.tiles import Changes, Part, grid, part_around
from pipeline import Detections, Frame, Header, Input, Operator, SettingsError
from pipeline.boxes import centres, in_picture

Array = NDArray[np.float32]
RAISE_AFTER = 15  # frames without a miss before one more tile is tried


@dataclass(frozen=True, kw_only=True)
class MovedSaliencySettings(SaliencySettings):
    """What a graph may set; a tile has the size of the network's input."""

    tiles: int = 8  # most that are looked at in one frame, beside the one at the ROI
    # as few where frames are missed, told by gaps in `seq`, so not for a sensor whose contexts are
    # not numbered one by one; 0: always `tiles`
    least_tiles: int = 0
    overlap_px: int = 48  # of neighbouring tiles, context pixels: no less than people measure
    change_levels: float = 12.0  # of 255: a smaller difference of 4x4 pixels is noise
    refresh_frames: int = 100  # a tile without change is looked at again after as many

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("tiles", "refresh_frames"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.least_tiles <= self.tiles:
            raise SettingsError(
                f"least_tiles: must be within 0..{self.tiles} (tiles), got {self.least_tiles}"
            )
        if not 0 <= self.overlap_px <= 256:
            raise SettingsError(f"overlap_px: must be within 0..256, got {self.overlap_px}")
        if not 0 < self.change_levels < 255:
            raise SettingsError(
                f"change_levels: must be above 0 and below 255, got {self.change_levels:g}"
            )


@dataclass(frozen=True, kw_only=True)
class TileBudget:
    """How many tiles there is time for in a frame, as missed frames tell.

    No clock decides: given the same frames it is the same.
    """

    tiles: int
    seq: int = -1  # of the latest frame
    kept_up: int = 0  # frames in succession

    def after(self, seq: int, least: int, most: int) -> "TileBudget":
        """Return it with one more frame: fewer tiles after a gap, after a while one more."""
        if 0 <= self.seq < seq - 1:
            fewer = self.tiles - max(1, self.tiles // 4)
            return TileBudget(tiles=max(least, fewer), seq=seq)
        if self.kept_up + 1 < RAISE_AFTER:
            return replace(self, seq=seq, kept_up=self.kept_up + 1)
        return TileBudget(tiles=min(most, self.tiles + 1), seq=seq)


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What parts of the context showed when they were last looked at."""

    found: Candidates  # boxes in context pixels
    features: Array  # (n, C)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> "Seen":
        """The named rows, in that order, or those of a mask."""
        return Seen(found=self.found.take(rows), features=self.features[rows])


class MovedSaliency(Operator[MovedSaliencySettings, Detections]):
    """One answer per frame, boxes in sensor pixels, of all tiles as they were last seen."""

    frame = Input(Frame, keep="latest")
    roi = Input(Frame, join=False)  # for its window

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
        self._roi: Array | None = None  # (4,) xyxy, sensor pixels
        self._budget = TileBudget(tiles=self.settings.tiles)

    def on_stream(self, header: Header) -> None:
        """Forget all tiles: another stream shows something else."""
        self._shape = ()
        self._before.forget()
        self._roi = None
        self._budget = TileBudget(tiles=self.settings.tiles)

    def on_roi(self, roi: Frame) -> None:
        """Remember where the sensor looked."""
        self._roi = np.array(roi.window, np.float32) if roi.pixels.size else None

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on, and how much of its output was unusable."""
        return self._detector.summary()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._detector.network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._detector.network.provider

    def state(self) -> None:
        """Nothing must survive: a successor looks at all tiles within a few frames."""

    def on_frame(self, frame: Frame) -> Detections:
        rules = self.settings
        if rules.least_tiles:
            self._budget = self._budget.after(frame.header.seq, rules.least_tiles, rules.tiles)
        if not frame.pixels.size:
            return answer(frame, nothing(), np.zeros((0, 0), np.float32), self._detector)
        picture = rgb(frame)
        if frame.window != self._window:
            self._before.forget()
            self._window = frame.window
        if picture.shape != self._shape:
            self._arrange(picture)
        difference = self._before.of(picture) if self._detector.reads_difference else None
        self._look(picture, difference, frame)
        found = best(self._seen, self.settings)
        whole = Placement(
            gain=1.0, left_px=0, top_px=0, width_px=picture.shape[1], height_px=picture.shape[0]
        )
        return answer(frame, to_sensor(found.found, whole, frame), found.features, self._detector)

    def _arrange(self, picture: NDArray[np.uint8]) -> None:
        self._shape = picture.shape
        self._tiles = grid(
            picture.shape[1], picture.shape[0], self._detector.size_px, self.settings.overlap_px
        )
        self._changes = Changes(self._tiles, levels=self.settings.change_levels)
        self._seen = Seen(
            found=nothing(), features=np.zeros((0, self._detector.channels), np.float32)
        )

    def _look(
        self, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None, frame: Frame
    ) -> None:
        """Look at the ROI's tile and up to `tiles` others of the picture; keep what they show."""
        changes = self._changes
        changes.compare(picture)
        last = []
        if self._roi is not None and within(self._roi[None], np.array(frame.window))[0]:
            tile_px, overlap_px = self._detector.size_px, self.settings.overlap_px
            roi = in_picture(self._roi, frame)
            last = [part_around(roi, frame.size_px, tile_px, overlap_px)]
            changes.looked_at(last[0][1])
        due = changes.due(self._budget.tiles, self.settings.refresh_frames)
        for tile in due:
            changes.looked_at_tile(tile)
        parts = [(self._tiles.windows[tile], self._tiles.cores[tile]) for tile in due]
        for window, core in parts + last:  # at the ROI it replaces what tiles tell
            shown = look(self._detector, picture, difference, window, core)
            self._seen = replaced(self._seen, shown, core)


def look(
    detector: Detector, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None,
    window: Part, core: Part,
) -> Seen:  # fmt: skip
    """What a window shows within its core; `difference` as `Detector.look` takes it."""
    left, top, right, bottom = window
    part = np.ascontiguousarray(picture[top:bottom, left:right])
    changed = None if difference is None else difference[top:bottom, left:right]
    found, at, features = detector.look(part, changed)
    appearance = np.zeros((len(found.scores), 0), np.float32)
    if features is not None:
        appearance = roi_align(features, found.boxes, stride_px=FEATURE_STRIDE_PX)
    offset = np.array([at.left_px, at.top_px] * 2, np.float32)
    boxes = (found.boxes - offset) / np.float32(at.gain) + np.array([left, top] * 2, np.float32)
    return Seen(found=replace(found, boxes=boxes), features=appearance).take(within(boxes, core))


def within(boxes: Array, part: Part) -> NDArray[np.bool_]:
    """Whether the middle of each box (n, 4) is in a part: (n,)."""
    middle = centres(boxes)
    return np.asarray(((middle >= part[:2]) & (middle < part[2:])).all(1))


def replaced(seen: Seen, shown: Seen, core: Part) -> Seen:
    """What was seen elsewhere, and what this part of the context shows now."""
    rest = seen.take(~within(seen.found.boxes, core))
    old, new = rest.found, shown.found
    return Seen(
        found=Candidates(
            boxes=np.concatenate([old.boxes, new.boxes]),
            angles=np.concatenate([old.angles, new.angles]),
            scores=np.concatenate([old.scores, new.scores]),
            classes=np.concatenate([old.classes, new.classes]),
        ),
        features=np.concatenate([rest.features, shown.features]),
    )


def best(seen: Seen, settings: SaliencySettings) -> Seen:
    """The best of all that was seen; what two tiles found on both sides of a border counts once."""
    order = np.argsort(-seen.found.scores, kind="stable")
    kept = suppress(seen.found.take(order), settings.nms_iou, agnostic=settings.class_agnostic)
    return seen.take(order[kept[: settings.max_objects]])
