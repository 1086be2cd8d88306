"""Turn a plan into sensor commands: Scanpath -> RoiSchedule (Eq. 6 as windows).

With several windows in one exposure, or a weight for objects that the plan does not choose, the
windows are those that show most of what the scanpath expects (several.py).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.scan import scan_window
from drivers.sensor import MOST_ROIS
from operators.dispatch.several import FAR_PX, best_windows, expected, grown, is_box
from pipeline.boxes import centres, roi_window
from pipeline.contract import SOURCE, Input, Operator
from pipeline.errors import SettingsError
from pipeline.forecast import Forecast, Upstream, coverage
from pipeline.messages import Geometry, Header, RoiSchedule, Scanpath, Tracks

Fill = Literal["hold", "centre", "scan"]
Window = tuple[int, int, int, int]  # xyxy, sensor pixels
DELAYS = (0, 2, 13, 60)  # frames from picture to command, as in the paper and in this project
MOST_WEIGHT = 1000.0


@dataclass(frozen=True, kw_only=True)
class DispatchSettings:
    """What a graph may set."""

    replan_every: int = 1  # Ta: frames from one plan to the next; 1: use every scanpath
    fill: Fill = "hold"  # where to look in frames for which a plan has no box
    settle: int = 0  # frames to wait at the start and after a longer gap, for tracks to form
    windows: int = 1  # of one exposure: the pixel budget, in windows
    others: float = 0.0  # weight of every track beside its probability in the scanpath
    margin: float = 0.5  # several windows: sides of a box that count as its surroundings, each side
    choose_every: int = 1  # several windows: rows of a plan that share them; each costs 1 ms
    least_gain: float = 0.0  # several windows: one that gains less weight is not read

    def __post_init__(self) -> None:
        if self.replan_every < 1:
            raise SettingsError(f"replan_every: must be at least 1, got {self.replan_every}")
        if self.fill not in ("hold", "centre", "scan"):
            raise SettingsError(f"fill: expected hold, centre or scan, got {self.fill}")
        if self.settle < 0:
            raise SettingsError(f"settle: must be at least 0, got {self.settle}")
        if self.choose_every < 1:
            raise SettingsError(f"choose_every: must be at least 1, got {self.choose_every}")
        if not 1 <= self.windows <= MOST_ROIS:
            raise SettingsError(f"windows: expected 1 to {MOST_ROIS}, got {self.windows}")
        for name in ("others", "margin", "least_gain"):
            if not 0 <= getattr(self, name) <= MOST_WEIGHT:
                got = getattr(self, name)
                raise SettingsError(f"{name}: expected 0 to {MOST_WEIGHT:g}, got {got}")

    @property
    def weighs(self) -> bool:
        """Whether windows are chosen by expected utility, not around the plan's object."""
        return self.windows > 1 or self.others > 0


@dataclass(frozen=True, kw_only=True)
class DispatchState:
    """The current plan, for a successor."""

    stream: str
    first_seq: int
    windows: NDArray[np.int32]  # (T, 4) or (T, K, 4) xyxy, sensor pixels; T 0: none yet
    last_seq: int = -1  # newest frame that a scanpath came for; -1: none yet
    since_seq: int = -1  # first frame after the last gap longer than `settle`


class Dispatch(Operator[DispatchSettings, RoiSchedule]):
    """One window of the sensor's ROI size per frame, around the box predicted for that frame.

    Several windows need `tracks`, as a scanpath has the box of its choice only. They are those of
    the last frame that came before the scanpath: in lockstep the frame before.
    """

    scanpath = Input(Scanpath, keep="every")
    tracks = Input(Tracks, join=False, optional=True)

    _tracks: Tracks | None = None

    @classmethod
    def advise(cls, settings: DispatchSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Yield how late a plan may arrive before frames have none.

        Raises `SettingsError` for more windows than the sensor reads in one exposure.
        """
        check_sensor(settings, upstream.get(SOURCE))
        if settings.weighs and "tracks" not in upstream:
            yield (
                "warning: without the input tracks, windows and others show the plan's choice only"
            )
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
        self._plan, self._tracks = _no_plan(""), None

    def on_stream(self, header: Header) -> None:
        """Forget the plan of another stream."""
        self._plan, self._tracks = _no_plan(header.stream), None

    def on_tracks(self, tracks: Tracks) -> None:
        """Store the predictions of all objects."""
        self._tracks = tracks

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
        if self.settings.weighs:
            windows = weighed_windows(scanpath, self._tracks, windows, self.settings)
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
        left, top, right, bottom = (int(side) for side in known[row].reshape(-1, 4)[0])
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


def weighed_windows(
    scanpath: Scanpath,
    tracks: Tracks | None,
    usual: NDArray[np.int32],
    settings: DispatchSettings,
) -> NDArray[np.int32]:
    """The best windows of each row: (T, K, 4), or (T, 4) of a single one.

    Rows of `usual` (T, 4) stand where no object is expected. A window without area is not read.
    """
    geometry = scanpath.header.geometry
    found = np.zeros((len(usual), settings.windows, 4), np.int32)
    for row in range(0, len(usual), settings.choose_every):
        seen = expected(scanpath, row, tracks, settings.others)
        wanted = replace(seen, boxes=grown(seen.boxes, settings.margin, geometry))
        best = best_windows(wanted, geometry, settings.windows, least_gain=settings.least_gain)
        shared = found[row : row + settings.choose_every]
        shared[:, 0] = usual[row : row + settings.choose_every]
        shared[:, : len(best)] = best
    return found if settings.windows > 1 else found[:, 0]


def check_sensor(settings: DispatchSettings, capture: Any) -> None:
    """Raise `SettingsError` for more windows than a source with known `rois` reads."""
    rois = getattr(capture, "rois", None)
    if isinstance(rois, int) and settings.windows > rois:
        raise SettingsError(
            f"windows: expected at most {rois}, as many as the sensor reads in one exposure "
            f"(rois), got {settings.windows}"
        )


def _no_plan(stream: str) -> DispatchState:
    return DispatchState(stream=stream, first_seq=0, windows=np.zeros((0, 4), np.int32))


def _centre(geometry: Geometry) -> Window:
    middle = np.array([geometry.width_px / 2, geometry.height_px / 2], np.float32)
    return roi_window(middle, geometry)
