"""Turn a plan into sensor commands: Scanpath -> RoiSchedule (Eq. 6 as windows)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.scan import scan_window
from pipeline.boxes import centres, roi_window
from pipeline.contract import Input, Operator
from pipeline.errors import SettingsError
from pipeline.forecast import Forecast, Upstream, coverage
from pipeline.messages import Geometry, Header, RoiSchedule, Scanpath

Fill = Literal["hold", "centre", "scan"]
Window = tuple[int, int, int, int]  # xyxy, sensor pixels
DELAYS = (0, 2, 13, 60)  # frames from picture to command, as in the paper and in this project
FAR_PX = 2.0**24  # beyond any field, but sums stay exact in float32


@dataclass(frozen=True, kw_only=True)
class DispatchSettings:
    """What a graph may set."""

    replan_every: int = 1  # Ta: frames from one plan to the next; 1: use every scanpath
    fill: Fill = "hold"  # where to look in frames for which a plan has no box
    settle: int = 0  # frames to wait at the start and after a longer gap, for tracks to form

    def __post_init__(self) -> None:
        if self.replan_every < 1:
            raise SettingsError(f"replan_every: must be at least 1, got {self.replan_every}")
        if self.fill not in ("hold", "centre", "scan"):
            raise SettingsError(f"fill: expected hold, centre or scan, got {self.fill}")
        if self.settle < 0:
            raise SettingsError(f"settle: must be at least 0, got {self.settle}")


@dataclass(frozen=True, kw_only=True)
class DispatchState:
    """The current plan, for a successor."""

    stream: str
    first_seq: int
    windows: NDArray[np.int32]  # (T, 4) xyxy, sensor pixels; T 0: none yet
    last_seq: int = -1  # newest frame that a scanpath came for; -1: none yet
    since_seq: int = -1  # first frame after the last gap longer than `settle`


class Dispatch(Operator[DispatchSettings, RoiSchedule]):
    """One window of the sensor's ROI size per frame, around the box predicted for that frame."""

    scanpath = Input(Scanpath, keep="every")

    @classmethod
    def advise(cls, settings: DispatchSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Yield how late a plan may arrive before frames have none."""
        horizon = getattr(upstream.get("scanpath"), "horizon", 0)
        if not horizon:
            return
        every = settings.replan_every
        if every > horizon:
            share = coverage(0, every, horizon)
            yield (
                f"warning: plans reach {horizon} frames and are made every {every}: at best "
                f"{share:.0%} of the frames have one, the others are filled by {settings.fill}"
            )
            return
        shares = ", ".join(f"{d}: {coverage(d, every, horizon):.0%}" for d in DELAYS)
        yield (
            f"plans reach {horizon} frames, a new one every {every}: every frame has one up to "
            f"{horizon - every} frames of delay; share of frames with a plan by delay {shares}"
        )

    @classmethod
    def forecast(cls, settings: DispatchSettings, upstream: Upstream) -> Forecast:
        """Return how far plans reach, and how often one is used."""
        horizon = getattr(upstream.settings.get("scanpath"), "horizon", 0)
        return Forecast(
            horizon_frames=horizon if isinstance(horizon, int) else 0,
            replan_frames=settings.replan_every,
        )

    def open(self) -> None:
        """Start without a plan."""
        self._plan = _no_plan("")

    def on_stream(self, header: Header) -> None:
        """Forget the plan of another stream."""
        self._plan = _no_plan(header.stream)

    def on_scanpath(self, scanpath: Scanpath) -> RoiSchedule | None:
        """Return a schedule for a scanpath that is due, otherwise None."""
        settled = self._settled(scanpath.header.seq)
        if not len(scanpath.boxes) or not settled or not self._due(scanpath.first_seq):
            return None
        geometry = scanpath.header.geometry
        held = self._held(scanpath.first_seq, geometry)
        windows = plan_windows(
            scanpath.boxes, scanpath.first_seq, geometry, fill=self.settings.fill, held=held
        )
        self._plan = replace(self._plan, first_seq=scanpath.first_seq, windows=windows)
        return RoiSchedule(
            header=scanpath.header,
            first_seq=scanpath.first_seq,
            windows=windows,
            scanpath_seq=scanpath.header.seq,
        )

    def state(self) -> DispatchState:
        """Return the current plan."""
        return self._plan

    def restore(self, state: Any) -> None:
        """Take over the plan of another instance."""
        self._plan = state

    def _due(self, first_seq: int) -> bool:
        if not len(self._plan.windows):
            return True
        return first_seq - self._plan.first_seq >= self.settings.replan_every

    def _settled(self, seq: int) -> bool:
        """Return whether frames have come for long enough since the start or the last gap."""
        plan, settle = self._plan, self.settings.settle
        gap = plan.last_seq < 0 or seq - plan.last_seq > settle
        since_seq = seq if gap else plan.since_seq
        self._plan = replace(plan, last_seq=seq, since_seq=since_seq)
        return seq - since_seq >= settle

    def _held(self, first_seq: int, geometry: Geometry) -> Window:
        """Return the window of the frame before `first_seq`, or the middle of the field."""
        known = self._plan.windows
        if not len(known):
            return _centre(geometry)
        row = min(max(first_seq - 1 - self._plan.first_seq, 0), len(known) - 1)
        left, top, right, bottom = (int(side) for side in known[row])
        return left, top, right, bottom


def plan_windows(
    boxes: NDArray[np.float32], first_seq: int, geometry: Geometry, *, fill: Fill, held: Window
) -> NDArray[np.int32]:
    """Windows (T, 4) of the ROI's size around boxes (T, 4), clamped to the field and aligned.

    A row without a valid box (empty, or not finite) is filled: `hold` repeats the previous window,
    initially `held`; `centre` uses the middle; `scan` visits the whole field.
    """
    windows = np.empty((len(boxes), 4), np.int32)
    for row, box in enumerate(boxes):
        if is_box(box):
            window = roi_window(centres(np.clip(box, -FAR_PX, FAR_PX)), geometry)
        elif fill == "centre":
            window = _centre(geometry)
        elif fill == "scan":
            window = scan_window(first_seq + row, geometry)
        else:
            window = held
        windows[row] = held = window
    return windows


def is_box(box: NDArray[np.float32]) -> bool:
    """Whether a row (4,) is a box with area."""
    return bool(np.isfinite(box).all() and box[2] > box[0] and box[3] > box[1])


def _no_plan(stream: str) -> DispatchState:
    return DispatchState(stream=stream, first_seq=0, windows=np.zeros((0, 4), np.int32))


def _centre(geometry: Geometry) -> Window:
    middle = np.array([geometry.width_px / 2, geometry.height_px / 2], np.float32)
    return roi_window(middle, geometry)
