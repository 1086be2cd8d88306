"""The contract of a plain camera: whole frames out, the newest first.

A plain camera has one stream and no ROI of its own. `CameraSensor` (in `drivers.cameras`) cuts
context and ROI from its frames in software, so that every graph runs on it unchanged.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pipeline.forecast import LinkUse


@dataclass(frozen=True, kw_only=True)
class Negotiated:
    """What the camera delivers, which may differ from what was asked for."""

    size_px: tuple[int, int]  # width, height
    rate_hz: float  # 0: it does not tell
    pixel_format: str  # of its pictures: rgb8 | bgr8 | grey8 | bayer_rggb8 …
    transport: str  # for a sentence about it, e.g. "V4L2, MJPG"


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """One whole frame, as the camera's memory holds it."""

    pixels: NDArray[np.uint8] | NDArray[np.uint16]  # (h, w, 3) colour, (h, w) grey or mosaic
    stamp_ns: int  # CLOCK_MONOTONIC at its arrival, or the camera's own stamp converted to it
    skipped: int = 0  # frames of the camera since the last picture that nobody gets


class Camera(Protocol):
    """`open read* close`; built as `Camera(settings)`; `close` is safe after any outcome.

    One that looks for its lost device says so in an attribute `absent_until_s`, as a sensor does.
    """

    settings_type: ClassVar[type[Any]]

    def open(self) -> Negotiated:
        """Acquire the device; raises `DriverError` with the reason in one sentence."""
        ...

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame that was not read yet, valid until the next call; None: none in time.

        A camera that was lost is reopened with back-off meanwhile; raises `DriverError` when it
        stays away longer than its settings allow.
        """
        ...

    def close(self) -> None:
        """Release the device; a `read` that waits in another thread returns None."""
        ...

    def summary(self) -> Mapping[str, Any]:
        """Figures of the run so far; also after `close`."""
        ...


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What a camera will deliver, and what crosses its link."""

    negotiated: Negotiated
    link: LinkUse


@runtime_checkable
class StatesPictures(Protocol):
    """What a camera may offer beside the contract, for the tables of `fovea check`."""

    def expected(self) -> Expected | None:
        """What it delivers: before `open` if it does what is asked of it, then as negotiated.

        None where neither tells.
        """
        ...
