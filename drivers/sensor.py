"""The contract of a dual-stream sensor: ROI schedules in, exposures of two frames out.

A sensor delivers its whole field of view as a small context picture and one region of it at full
resolution, from the same exposure. Real and simulated sensors fulfil this contract and pass the
same tests; `operators.capture` depends only on it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

from drivers.source import Annotations
from pipeline.contract import Loan
from pipeline.forecast import Forecast
from pipeline.messages import Frame, Geometry, Header, RoiSchedule

EMPTY_WINDOW = (0, 0, 0, 0)
FURTHER = ("roi_2", "roi_3", "roi_4")  # outputs of the windows beside `roi`
MOST_ROIS = 1 + len(FURTHER)  # windows of one exposure


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """What a sensor can do; known once it is open."""

    geometry: Geometry  # pixel grid, size and step of the ROI window in use
    context_px: tuple[int, int]  # width, height of the context picture
    context_binning: float  # sensor pixels per context pixel, along one side
    roi_sizes_px: tuple[tuple[int, int], ...]  # window sizes it can read; none: it has no ROI
    roi_binning: float  # sensor pixels per ROI pixel, along one side
    rates_hz: tuple[float, float]  # lowest and highest
    pixel_formats: tuple[str, ...]  # what `Mode.pixel_format` may ask for
    lead_frames: int  # a command made from frame j affects frame j + lead_frames at the earliest
    same_exposure: bool = (
        True  # False: the ROI is exposed after the context, `Frame.delay_ns` later
    )
    rois: int = 1  # windows that it reads in one exposure, `MOST_ROIS` at most


@dataclass(frozen=True, kw_only=True)
class Mode:
    """The mode, set between `open` and `start`; 0 and "" keep a value."""

    rate_hz: float = 0.0
    roi_px: tuple[int, int] = (0, 0)
    pixel_format: str = ""


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """The pictures of one exposure, under one header.

    `roi` is empty, with an empty window, when the sensor reads no region in this exposure. A sensor
    that cannot expose both at once says so (`Capabilities.same_exposure`, `Frame.delay_ns`). A
    simulated sensor may include the ground truth; only the oracle strategy uses it. `further` are
    windows 2 to K of a sensor that reads K, empty where they are not read. `full` is the whole
    field at full resolution, from a simulated sensor that was asked for it, for viewers.
    """

    header: Header
    context: Frame
    roi: Frame
    truth: Annotations | None = None
    further: tuple[Frame, ...] = ()  # Capabilities.rois - 1 of them
    full: Frame | None = None


class DualStreamSensor(Protocol):
    """`open configure start (set_rois | read)* stop close`; `close` is safe after any outcome.

    Built as `Sensor(settings)` with an instance of `settings_type`, a frozen dataclass. One that
    looks for its lost device while `read` waits has an attribute `absent_until_s`, until when it
    does, in `time.monotonic()`, 0 otherwise: the node is then not stalled.
    """

    settings_type: ClassVar[type[Any]]

    def open(self, *, realtime: bool) -> None:
        """Acquire the device under a new stream id; raises `DriverError`.

        `realtime` False is lockstep: exposure k+1 happens when it is asked for.
        """
        ...

    def capabilities(self) -> Capabilities:
        """The sensor's capabilities; only after `open`."""
        ...

    def configure(self, mode: Mode) -> None:
        """Set the mode before `start`; raises `SettingsError` for an unsupported one."""
        ...

    def start(self) -> None:
        """Begin to expose."""
        ...

    def set_rois(self, schedule: RoiSchedule) -> None:
        """Command the windows of coming frames; may be called by another thread than `read`.

        Windows of the wrong size are replaced by one of the ROI's size around the same centre;
        then clamped to the field, then aligned down to the sensor's step. The frame contains the
        actual window. Late schedules and those of another stream are counted, not used. Raises
        `RefusedSchedule` for more windows in one frame than `Capabilities.rois`.
        """
        ...

    def read(self, loan: Loan) -> Exposure | None:
        """The next exposure, written into memory from `loan("context" | "roi", shape, dtype)`.

        Windows 2 to K are written into memory from `loan("roi_2", …)` to `loan("roi_4", …)`.

        Memory that is lent with `ahead=True` stays lent until an exposure with it was returned:
        for a device that writes before it says what comes; at most two of an output.
        Blocks until it is available; None after the last one and after `stop`. When `loan` raises
        `PoolExhausted`, the exposure is lost (`seq` advances) and the error passes through.
        """
        ...

    def stop(self) -> None:
        """End exposing; a `read` that waits in another thread returns None."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...

    def summary(self) -> Mapping[str, Any]:
        """Figures of the run so far; also after `close`."""
        ...


@runtime_checkable
class StatesStreams(Protocol):
    """What a sensor may offer beside the contract, for the tables of `fovea check`."""

    def forecast(self) -> Forecast:
        """What it will send as `context` and `roi`, and what crosses its link.

        Before `open` as far as the settings tell, without touching the device; between `open` and
        `close` as the device says. What neither tells is left out, never guessed. Raises
        `SettingsError` for a mode that the device is known not to have.
        """
        ...
