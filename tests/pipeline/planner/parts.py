"""Sources for the tests of the planner: one that states anything, and what reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pipeline import Frame, Input, Message, Operator, Source
from pipeline.forecast import Forecast, LinkUse, PictureStream, Upstream, pictures


@dataclass(frozen=True, kw_only=True)
class EyeSettings:
    """What it states."""

    size_px: tuple[int, int] = (640, 480)
    pixel_format: str = "rgb8"
    rate_hz: float = 30.0
    kind: str = ""
    fault: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)


class Eye(Source[EyeSettings, Frame]):
    """States a stream, and is never run."""

    @classmethod
    def forecast(cls, settings: EyeSettings, upstream: Upstream) -> Forecast:
        if settings.fault == "raises":
            raise ZeroDivisionError("no rate")
        if settings.fault == "nonsense":
            return "30 Hz"  # type: ignore[return-value]
        if settings.fault == "streams":
            return Forecast(streams={"out": 5})  # type: ignore[dict-item]
        stream = pictures(settings.size_px, settings.pixel_format, settings.rate_hz)
        note = "it was asked" if upstream.ask else ""
        link = LinkUse(streams=(stream,), kind=settings.kind)
        return Forecast(streams={"out": stream}, link=link, rate_hz=settings.rate_hz, note=note)

    def produce(self) -> Mapping[str, Message] | None:
        raise NotImplementedError


class Half(Operator[EyeSettings, Frame]):
    """States half of what it reads."""

    frame = Input(Frame)

    @classmethod
    def forecast(cls, settings: EyeSettings, upstream: Upstream) -> Forecast:
        taken = upstream.streams.get("frame")
        if taken is None or taken.frame_bytes is None:
            return Forecast()
        width, height = taken.size_px
        half = PictureStream(
            size_px=(width // 2, height), pixel_format="rgb8",
            frame_bytes=taken.frame_bytes // 2, rate_hz=taken.rate_hz,
        )  # fmt: skip
        return Forecast(streams={"out": half})

    def on_frame(self, frame: Frame) -> Frame:
        return frame
