"""A network stream: an RTSP, HTTP or MPEG-TS address or a GStreamer pipeline in, frames out."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from drivers.camera import Expected, Negotiated, Picture
from drivers.cameras import opencv
from drivers.cameras.address import address, pipeline_shown, read_credentials, with_user
from drivers.cameras.diagnosis import why_not
from drivers.cameras.link import LinkSettings
from drivers.cameras.opencv_camera import OpenCvCamera
from pipeline.errors import DriverError, SettingsError
from pipeline.forecast import LinkUse, PictureStream

MOST_THREADS = 64
LONGEST_PIPELINE = 8192  # characters


@dataclass(frozen=True, kw_only=True)
class NetworkStreamSettings(LinkSettings):
    """Exactly one of `url` and `pipeline`; the limits of `LinkSettings` hold for both."""

    url: str = field(default="", repr=False)  # rtsp rtsps http https udp tcp
    credentials_path: str = ""  # file of one line user:password, mode 0600, for `url`
    pipeline: str = field(default="", repr=False)  # of GStreamer, ends in appsink
    decode_threads: int = 1  # each one more delays the picture by a frame; a pipeline has its own

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.url) == bool(self.pipeline):
            got = "both" if self.url else "neither"
            raise SettingsError(f"url or pipeline: expected exactly one of them, got {got}")
        if self.url and self.credentials_path and address(self.url).has_user:
            raise SettingsError("url: expected no user beside credentials_path, got one")
        if self.url:
            address(self.url)
        elif self.credentials_path:
            raise SettingsError("credentials_path: belongs to a url, got a pipeline")
        if not 1 <= self.decode_threads <= MOST_THREADS:
            raise SettingsError(
                f"decode_threads: expected 1 to {MOST_THREADS}, got {self.decode_threads}"
            )
        if self.pipeline and "appsink" not in self.pipeline:
            raise SettingsError("pipeline: expected an appsink at its end, got none")
        if len(self.pipeline) > LONGEST_PIPELINE:
            got = f"got {len(self.pipeline)}"
            raise SettingsError(f"pipeline: expected up to {LONGEST_PIPELINE} characters, {got}")


class NetworkStream:
    """A `Camera` over FFmpeg or GStreamer by OpenCV, reopened when the server comes back."""

    settings_type: ClassVar[type[Any]] = NetworkStreamSettings

    def __init__(self, settings: NetworkStreamSettings) -> None:
        self._settings = settings
        if settings.url:
            self.source = address(settings.url).shown
        else:
            self.source = pipeline_shown(settings.pipeline)
        self._camera = OpenCvCamera(self._connect, settings, name=self.source)

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        return self._camera.absent_until_s

    def open(self) -> Negotiated:
        """Open the stream; raises `DriverError` with the reason in one sentence."""
        if self._settings.pipeline and not opencv.has(opencv.GSTREAMER):
            raise DriverError(
                f"pipeline: expected an OpenCV with GStreamer, got {opencv.version()}, which was "
                "built without it: use url, or an OpenCV of your distribution"
            )
        return self._honest(self._camera.open())

    def expected(self) -> Expected | None:
        """What the stream turned out to be; None before it was open. What crosses is compressed."""
        if self._camera.negotiated is None:
            return None
        told = self._honest(self._camera.negotiated)
        crossing = PictureStream(
            size_px=told.size_px, pixel_format=self._camera.told.fourcc or "compressed",
            frame_bytes=None, rate_hz=told.rate_hz,
        )  # fmt: skip
        return Expected(negotiated=told, link=LinkUse(streams=(crossing,)))

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame that was not read yet."""
        return self._camera.read(timeout_s)

    def close(self) -> None:
        """Close the stream."""
        self._camera.close()

    def summary(self) -> Mapping[str, Any]:
        """What the stream says of itself, and what happened on the link."""
        return self._camera.summary()

    def _honest(self, told: Negotiated) -> Negotiated:
        """Without a rate where it is made up: JPEG tells none, and FFmpeg invents one."""
        return replace(told, rate_hz=0.0) if self._camera.told.fourcc == "MJPG" else told

    def _connect(self) -> opencv.OpenCvConnection:
        settings = self._settings
        place, backend = settings.pipeline or settings.url, opencv.GSTREAMER
        parameters = opencv.stream_parameters(
            open_timeout_s=settings.open_timeout_s, read_timeout_s=settings.read_timeout_s
        )
        if settings.url:
            backend = opencv.FFMPEG
            parameters |= opencv.decoder_parameters(settings.decode_threads)
            if settings.credentials_path:
                place = with_user(settings.url, *read_credentials(settings.credentials_path))
        connection = opencv.connect(
            place,
            backend,
            name=self.source,
            parameters=parameters,
            read_timeout_s=settings.read_timeout_s,
        )
        if connection is None:
            raise DriverError(f"{self.source}: {self._reason(place)}")
        try:
            self._check_live(connection.told().length)
        except DriverError:
            connection.close()
            raise
        return connection

    def _reason(self, place: str) -> str:
        if self._settings.pipeline:
            return "GStreamer cannot start it; try it with gst-launch-1.0"
        return why_not(address(place), timeout_s=self._settings.open_timeout_s)

    def _check_live(self, length: int) -> None:
        """A server of recordings sends as fast as it can; an RTSP server keeps the time."""
        if length and self._settings.url.startswith(("http:", "https:")):
            raise DriverError(
                f"{self.source}: expected a live stream, got a recording of {length} frames: "
                "download it and play it with drivers.datasets:VideoFile"
            )
