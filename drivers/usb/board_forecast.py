"""What a board will send: settings and capabilities in, the figures of `fovea check` out."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from drivers.usb.board_settings import (
    DualStreamBoardSettings,
    asked,
    backend_settings,
    picture_px,
    pixel_format,
    roi_size,
)
from drivers.usb.capabilities import BoardCapabilities, CaptureMode
from pipeline.forecast import Forecast, LinkUse, PictureStream, pictures

UNKNOWN = "a board tells its sizes, formats and link once it is open"


@dataclass(frozen=True, kw_only=True)
class KnownBoard:
    """A board that is known before it is attached."""

    can: BoardCapabilities
    readout_frames: float  # from the exposure to the first byte that a host can read


@runtime_checkable
class KnowsItsBoard(Protocol):
    """Settings of a backend of pyusb that say which board it has, as those of a virtual one."""

    def known_board(self) -> KnownBoard:
        """The only board on its bus."""
        ...


def board_of(settings: DualStreamBoardSettings) -> KnownBoard | None:
    """Return the board that the settings of the backend describe; None: only the bus knows."""
    options = backend_settings(settings)
    return options.known_board() if isinstance(options, KnowsItsBoard) else None


def forecast_of(
    settings: DualStreamBoardSettings,
    can: BoardCapabilities,
    *,
    readout_frames: float = 0.0,
    kind: str = "",
) -> Forecast:
    """Return the streams of a board, and what they need of its link.

    Where the link's rate is known, a frame takes its time on it. Raises `SettingsError` for a mode
    that the board does not have; what the link does not carry is for the planner to refuse.
    """
    wanted = asked(settings, can)
    size, form = roi_size(settings, can), pixel_format(settings, can)
    rate_hz = wanted.rate_mhz / 1000
    live = wanted.mode is CaptureMode.LIVE
    sent_hz = rate_hz if live else can.preview_mhz / 1000
    context = pictures(can.context_px, form.name, sent_hz)
    roi = pictures(picture_px(size), form.name, sent_hz if live else 0.0)
    link = LinkUse(
        streams=(context, roi) if live else (context,),
        kind=kind,
        carries_bytes_per_s=float(settings.link_bytes_per_s or can.link_bytes_per_s),
    )
    frames = settings.burst_frames or can.burst_frames
    return Forecast(
        streams={"context": context, "roi": roi},
        note="" if live else _burst(frames, (context, roi), link.carries_bytes_per_s),
        link=link,
        rate_hz=rate_hz,
        lead_frames=can.lead_frames,
        readout_frames=readout_frames + (_on_the_link(link, rate_hz) if live else 0.0),
        burst_frames=0 if live else frames,
    )


def _on_the_link(link: LinkUse, rate_hz: float) -> float:
    """The frames' time that both pictures of an exposure take."""
    sizes = [stream.frame_bytes or 0 for stream in link.streams]
    return sum(sizes) / link.carries_bytes_per_s * rate_hz if link.carries_bytes_per_s else 0.0


def _burst(frames: int, pair: tuple[PictureStream, PictureStream], carries: float) -> str:
    nbytes = frames * sum(stream.frame_bytes or 0 for stream in pair)
    lasts = f", {nbytes / carries:.3g} s on the link" if carries else ""
    return (
        f"mode record: previews of the context; a burst of {frames} frames is {nbytes / 1e6:.0f} MB"
        f"{lasts}"
    )
