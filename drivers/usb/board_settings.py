"""Settings of a dual-stream board, and the configuration that follows from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drivers.usb.capabilities import BoardCapabilities, CaptureMode, RoiSize
from drivers.usb.requests import Configuration
from pipeline import pixel_formats
from pipeline.errors import MessageError, SettingsError
from pipeline.import_path import imported
from pipeline.pixel_formats import BY_CODE, PixelFormat
from pipeline.settings import build


@dataclass(frozen=True, kw_only=True)
class DualStreamBoardSettings:
    """What a graph may set; 0 and "" leave the choice to the board."""

    serial: str = ""  # of the board; empty: the only one that is attached
    rate_hz: float = 0.0  # 0: the highest
    roi_px: tuple[int, int] = (0, 0)  # window, sensor pixels; 0: the board's first size
    pixel_format: str = ""  # empty: rgb8, or the first that the board has
    mode: Literal["live", "record"] = "live"
    burst_frames: int = 0  # of a recording; 0: the most the board keeps
    payload_crc: bool = False  # costs 2.4 ms for a picture of 9 MB
    in_flight: int = 16  # bulk reads of 512 KiB; Linux grants 16 MiB to all devices
    link_bytes_per_s: int = 0  # what the link carries; 0: what the board says
    reconnect_s: float = 30.0  # how long a board may be away
    backend: str = ""  # import path of a pyusb backend; empty: libusb
    backend_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.pixel_format:
            try:
                pixel_formats.pixel_format(self.pixel_format, "pixel_format")
            except MessageError as error:
                raise SettingsError(str(error)) from None
        if not 0 <= self.rate_hz <= 10_000:
            raise SettingsError(f"rate_hz: expected 0 to 10000, got {self.rate_hz}")
        if not 1 <= self.in_flight <= 24:
            raise SettingsError(f"in_flight: expected 1 to 24, got {self.in_flight}")
        if not 0 <= self.reconnect_s <= 3600:
            raise SettingsError(f"reconnect_s: expected 0 to 3600, got {self.reconnect_s}")
        for name in ("burst_frames", "link_bytes_per_s"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if min(self.roi_px) < 0:
            raise SettingsError(f"roi_px: must not be negative, got {self.roi_px}")


def backend_settings(settings: DualStreamBoardSettings) -> Any:
    """Return the settings of the backend; None for libusb. Raises `SettingsError`."""
    if not settings.backend:
        return None
    found = imported(settings.backend, SettingsError, "backend")
    return build(found.settings_type, settings.backend_options, "backend_options")


def configuration(settings: DualStreamBoardSettings, can: BoardCapabilities) -> Configuration:
    """Return what to ask of a board; raises `SettingsError` for what it or the link cannot do."""
    wanted = asked(settings, can)
    if wanted.mode is CaptureMode.LIVE:
        _check_link(settings, can, wanted)
    return wanted


def asked(settings: DualStreamBoardSettings, can: BoardCapabilities) -> Configuration:
    """Return what to ask of a board, whatever its link; raises `SettingsError`."""
    mode = CaptureMode[settings.mode.upper()]
    if mode not in can.modes:
        modes = ", ".join(m.name.lower() for m in can.modes)
        raise SettingsError(f"mode: expected {modes}, as the board can, got {settings.mode}")
    if settings.burst_frames > can.burst_frames:
        raise SettingsError(
            f"burst_frames: expected at most {can.burst_frames}, got {settings.burst_frames}"
        )
    size, form = roi_size(settings, can), pixel_format(settings, can)
    return Configuration(
        rate_mhz=_rate_mhz(settings, can),
        roi_px=(size.width_px, size.height_px),
        pixel_format=form.code,
        mode=mode,
        payload_crc=settings.payload_crc,
        burst_frames=settings.burst_frames,
    )


def roi_size(settings: DualStreamBoardSettings, can: BoardCapabilities) -> RoiSize:
    """Return the size of the window; (0, 0) where the board reads none."""
    if settings.roi_px == (0, 0):
        return can.roi_sizes[0] if can.roi_sizes else RoiSize(0, 0)
    for size in can.roi_sizes:
        if (size.width_px, size.height_px) == settings.roi_px:
            return size
    sizes = ", ".join(f"{size.width_px}x{size.height_px}" for size in can.roi_sizes)
    got = f"{settings.roi_px[0]}x{settings.roi_px[1]}"
    raise SettingsError(f"roi_px: expected {sizes or 'none'}, got {got}")


def pixel_format(settings: DualStreamBoardSettings, can: BoardCapabilities) -> PixelFormat:
    """Return the format of both streams; a mosaic's is that of the sensor's first pixel."""
    known = known_formats(can)
    if not known:
        codes = ", ".join(f"{code:#010x}" for code in can.formats)
        raise SettingsError(
            f"pixel_format: expected a board with one of pipeline.pixel_formats, got {codes}"
        )
    fitting = [form for form in known if settings.pixel_format in ("", form.name)]
    if not fitting:
        names = ", ".join(form.name for form in known)
        raise SettingsError(f"pixel_format: expected {names}, got {settings.pixel_format!r}")
    return fitting[0]


def known_formats(can: BoardCapabilities) -> list[PixelFormat]:
    """Return what the board can send, in its order after rgb8; unknown codes are left out."""
    known = [BY_CODE[code] for code in can.formats if code in BY_CODE]
    return sorted(known, key=lambda form: form.name != "rgb8")


def picture_px(size: RoiSize) -> tuple[int, int]:
    """Return width and height of the picture of a window."""
    return size.width_px // size.binning, size.height_px // size.binning


def _rate_mhz(settings: DualStreamBoardSettings, can: BoardCapabilities) -> int:
    lowest, highest = can.rates_mhz
    wanted = round(settings.rate_hz * 1000) or highest
    if not lowest <= wanted <= highest:
        raise SettingsError(
            f"rate_hz: expected {lowest / 1000:g} to {highest / 1000:g}, got {settings.rate_hz:g}"
        )
    return wanted


def _check_link(
    settings: DualStreamBoardSettings, can: BoardCapabilities, wanted: Configuration
) -> None:
    """Refuse what the link does not carry, with the figures."""
    limit = settings.link_bytes_per_s or can.link_bytes_per_s
    form, size = pixel_format(settings, can), roi_size(settings, can)
    pictures = [can.context_px, picture_px(size)]
    frame_bytes = sum(form.row_bytes(width) * height for width, height in pictures)
    needed = frame_bytes * wanted.rate_mhz / 1000
    if limit and needed > limit:
        raise SettingsError(
            f"rate_hz: {form.name} at {wanted.rate_mhz / 1000:g} Hz needs {needed / 1e6:.0f} MB/s, "
            f"the link carries {limit / 1e6:.0f}: at most {limit / frame_bytes:.3g} Hz"
        )
