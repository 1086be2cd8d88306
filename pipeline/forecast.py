"""What an operator expects to send, as far as its settings tell: figures for `fovea check`.

Whatever is not stated is shown as not known, never guessed: a `Forecast()` states nothing.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pipeline.errors import SettingsError
from pipeline.pixel_formats import pixel_format as format_of

FIGURES = (
    "rate_hz",
    "lead_frames",
    "readout_frames",
    "horizon_frames",
    "replan_frames",
    "burst_frames",
)


@dataclass(frozen=True, kw_only=True)
class PictureStream:
    """Pictures of one size, sent at one rate; sides and bytes of 0 where none are sent."""

    size_px: tuple[int, int]  # width, height
    pixel_format: str  # of pipeline.pixel_formats, or what only a link carries, as MJPG
    frame_bytes: int | None  # of one picture; None: not known, as of a compressed one
    rate_hz: float = 0.0  # 0: not known

    def __post_init__(self) -> None:
        if min(self.size_px) < 0 or (self.frame_bytes or 0) < 0:
            got = f"{self.size_px} of {self.frame_bytes} bytes"
            raise SettingsError(f"size_px: expected sides and bytes from 0 on, got {got}")
        if not (math.isfinite(self.rate_hz) and self.rate_hz >= 0):
            raise SettingsError(f"rate_hz: expected a number from 0 on, got {self.rate_hz}")

    @property
    def bytes_per_s(self) -> float | None:
        """Bytes a second; None where bytes or rate are not known."""
        if self.frame_bytes == 0:
            return 0.0
        return self.frame_bytes * self.rate_hz if self.frame_bytes and self.rate_hz else None


def pictures(size_px: tuple[int, int], pixel_format: str, rate_hz: float = 0.0) -> PictureStream:
    """Return a stream in a format of `pipeline.pixel_formats`; each row begins at a byte.

    Raises `MessageError` for an unknown format.

    >>> pictures((2041, 2), "bayer_rggb10p", 30).frame_bytes  # 20410 bits a row
    5104
    """
    width, height = size_px
    frame_bytes = format_of(pixel_format, "pixel_format").row_bytes(width) * height
    return PictureStream(
        size_px=size_px, pixel_format=pixel_format, frame_bytes=frame_bytes, rate_hz=rate_hz
    )


@dataclass(frozen=True, kw_only=True)
class LinkUse:
    """What crosses the cable between a sensor and this host."""

    streams: tuple[PictureStream, ...]
    kind: str = ""  # key of pipeline.planner.links.LINKS; empty: not known
    carries_bytes_per_s: float = 0.0  # what the device states, above which it is refused; 0: none


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """The figures of one node. Delays are in frames of the sensor."""

    streams: Mapping[str, PictureStream] = field(default_factory=dict)  # by output
    note: str = ""  # why something is not known, or what else there is to know
    # of a source
    link: LinkUse | None = None
    rate_hz: float = 0.0  # exposures a second; 0: not known
    lead_frames: int = 0  # a command made from j affects j + lead_frames first; 0: not known
    readout_frames: float = 0.0  # from the exposure until the host has its frame
    burst_frames: int = 0  # that it records along a plan, and no others; 0: every frame is live
    # of a node that sends commands to a source
    horizon_frames: int = 0  # Tp, how far its plans reach; 0: not known
    replan_frames: int = 0  # Ta, from one plan to the next; 0: not known

    def __post_init__(self) -> None:
        for name in FIGURES:
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name}: expected a number from 0 on, got {value}")


@dataclass(frozen=True, kw_only=True)
class Upstream:
    """What `Operator.forecast` is told of the nodes before it."""

    settings: Mapping[str, Any]  # of the node that feeds each connected input, by input
    streams: Mapping[str, PictureStream]  # by input, where they are known
    ask: bool = False  # devices may be opened and asked


def coverage(delay_frames: int, replan_every: int, horizon: int) -> float:
    """Return the share of frames for which the current plan has a window.

    A plan made from frame j covers j+1 … j+horizon and takes effect after `delay_frames`; the next
    one replaces it `replan_every` frames later.

    >>> coverage(8, 8, 16), coverage(13, 8, 16), coverage(20, 8, 16)
    (1.0, 0.375, 0.0)
    """
    return min(max(horizon - delay_frames, 0), replan_every) / replan_every
