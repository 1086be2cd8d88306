"""Settings of an industrial camera that foveates."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.genicam.camera import GenicamCameraSettings
from pipeline.errors import SettingsError


@dataclass(frozen=True, kw_only=True)
class GenicamSensorSettings:
    """Zeros and empty texts keep what the camera has."""

    camera: str = ""  # id, serial, user name or address; empty: the only one attached
    features: Mapping[str, bool | int | float | str] = field(default_factory=dict)  # by SFNC name
    binning: int = 0  # of the context; field and ROI follow from it; 0: 4, or the nearest there is
    pixel_format: str = ""  # PFNC name, e.g. BayerRG8; empty: the camera's, or the best it has
    rate_hz: float = 0.0  # of exposures, each of two frames; 0: as fast as it answers
    buffers: int = 4  # in flight
    packet_bytes: int = 0  # GigE Vision; 0: the largest that arrives
    answer_s: float = 2.0  # a frame that takes longer after its trigger is lost
    absent_s: float = 6.0  # a lost camera that stays away longer is an error

    def __post_init__(self) -> None:
        self.camera_settings()
        if not (math.isfinite(self.rate_hz) and 0 <= self.rate_hz <= 1000):
            raise SettingsError(f"rate_hz: expected 0 to 1000, got {self.rate_hz}")
        if self.binning == 1:
            raise SettingsError("binning: expected 0 or 2 to 32, got 1: context and ROI are one")
        if not 0.01 <= self.answer_s <= 60:
            raise SettingsError(f"answer_s: expected 0.01 to 60, got {self.answer_s}")

    def camera_settings(self) -> GenicamCameraSettings:
        """What is set as for a plain camera; raises `SettingsError`."""
        return GenicamCameraSettings(
            camera=self.camera,
            features=self.features,
            binning=self.binning,
            pixel_format=self.pixel_format,
            buffers=self.buffers,
            packet_bytes=self.packet_bytes,
            absent_s=self.absent_s,
        )
