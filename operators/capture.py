"""Operate the sensor: ROI schedules in, context and ROI frames of each exposure out.

A simulated sensor that knows the ground truth also sends it, for scoring.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import DTypeLike, NDArray

from drivers.commands import RefusedSchedule
from drivers.sensor import FURTHER, DualStreamSensor, StatesStreams
from drivers.source import Annotations
from pipeline.contract import HEADLINE, Input, Output, Source
from pipeline.errors import DriverError, SettingsError
from pipeline.forecast import Forecast, Upstream
from pipeline.import_path import imported
from pipeline.messages import Frame, Header, Message, RoiSchedule, Truth
from pipeline.settings import build

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class CaptureSettings:
    """The sensor class and its own settings."""

    sensor: str = "drivers.simulated:SimulatedSensor"  # import path module:Class
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.build()  # so that errors are raised before a process starts

    @property
    def shows(self) -> str:
        """The kind of scene before the sensor (soccer); empty if unknown."""
        return str(getattr(self.build(), "shows", ""))

    @property
    def source(self) -> str:
        """The origin of the pictures, for messages."""
        return str(getattr(self.build(), "source", self.sensor))

    @property
    def rois(self) -> int:
        """How many windows the sensor reads in one exposure, by its options; 1 if unsaid."""
        sensor = _load(self.sensor)
        return int(getattr(build(sensor.settings_type, self.options, "options"), "rois", 1))

    def build(self) -> DualStreamSensor:
        """Return the sensor, not yet open; raises `SettingsError`."""
        sensor = _load(self.sensor)
        built: DualStreamSensor = sensor(build(sensor.settings_type, self.options, "options"))
        return built


class Capture(Source[CaptureSettings, Frame]):
    """Reads exposures at the sensor's pace and passes on commands from another thread."""

    schedule = Input(RoiSchedule, command=True)
    context = Output(Frame)
    roi = Output(Frame)
    roi_2 = Output(Frame)  # further windows of the same exposure, where the sensor reads several
    roi_3 = Output(Frame)
    roi_4 = Output(Frame)
    full = Output(Frame)  # the whole field, where a simulated sensor is asked for it
    truth = Output(Truth)

    _sensor: DualStreamSensor | None = None
    _refused: int = 0  # schedules

    @classmethod
    def forecast(cls, settings: CaptureSettings, upstream: Upstream) -> Forecast:
        """Return what the sensor states: from its options or, if it may be asked, once open."""
        sensor = settings.build()
        if not isinstance(sensor, StatesStreams):
            return Forecast(note=f"{settings.sensor} does not state its streams")
        if not upstream.ask:
            return sensor.forecast()
        try:
            sensor.open(realtime=False)
            return sensor.forecast()
        finally:
            sensor.close()

    @property
    def absent_until_s(self) -> float:
        """Until when the sensor looks for its lost device; 0 too for one that does not tell."""
        return float(getattr(self._sensor, "absent_until_s", 0.0))

    def open(self) -> None:
        """Open and start the device."""
        self._sensor = sensor = self.settings.build()
        sensor.open(realtime=self.realtime)
        sensor.start()

    def on_schedule(self, schedule: RoiSchedule) -> None:
        """Pass a command to the sensor. One that it cannot obey is counted; the sensor goes on."""
        try:
            self._opened().set_rois(schedule)
        except RefusedSchedule as error:
            if not self._refused:
                log.warning("%s; it is not used, nor are others like it", error)
            self._refused += 1

    def produce(self) -> Mapping[str, Message] | None:
        """Return the next exposure, one message per stream."""
        exposure = self._opened().read(self._memory)
        if exposure is None:
            return None
        answers: dict[str, Message] = {"context": exposure.context, "roi": exposure.roi}
        answers.update(zip(FURTHER, exposure.further, strict=False))
        if exposure.full is not None:
            answers["full"] = exposure.full
        if exposure.truth is not None:
            answers["truth"] = truth_of(exposure.truth, exposure.header)
        return answers

    def summary(self) -> Mapping[str, Any]:
        """Return the sensor's figures, and how many schedules it could not obey."""
        found = dict(self._sensor.summary()) if self._sensor else {}
        if self._refused:
            told = f"{self._refused} schedules were refused, as the log says"
            found["refused_schedules"] = self._refused
            found[HEADLINE] = "; ".join([*filter(None, [found.get(HEADLINE)]), told])
        return found

    def close(self) -> None:
        """Stop and release the device."""
        if self._sensor is not None:
            self._sensor.stop()
            self._sensor.close()

    def _memory(
        self, output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        return self.loan(shape, dtype, output, ahead=ahead)

    def _opened(self) -> DualStreamSensor:
        if self._sensor is None:
            raise DriverError(f"capture: {self.settings.sensor} is not open")
        return self._sensor


def truth_of(known: Annotations, header: Header) -> Truth:
    """Return the ground truth as a message."""
    return Truth(
        header=header,
        boxes=known.boxes,
        ids=known.ids,
        labels=known.labels,
        visibility=known.visibility,
    )


def _load(path: str) -> Any:
    found = imported(path, SettingsError, "sensor")
    if not hasattr(found, "settings_type"):
        raise SettingsError(f"sensor: expected a DualStreamSensor, got {path}")
    return found
