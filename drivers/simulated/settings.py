"""Settings of the simulated sensor, and the sampling and geometry derived from them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.noise import Response
from drivers.readout import geometry_of
from drivers.sensor import MOST_ROIS
from drivers.simulated.sources import check_arguments, scene_path
from drivers.simulated.strategies import (
    STRATEGIES,
    Sampling,
    Strategy,
    check_budget,
    sampling,
)
from pipeline.errors import SettingsError
from pipeline.messages import Geometry
from pipeline.pixel_formats import FORMATS, PixelFormat
from pipeline.settings import suggest

RATES_HZ = (0.01, 10_000.0)
MOSAICS = tuple(name for name, form in FORMATS.items() if form.order)


@dataclass(frozen=True, kw_only=True)
class SimulatedSensorSettings:
    """Settings of the simulated sensor; exactly one of `scene` and `source` is required."""

    scene: str = ""  # soccer, panorama, or an import path module:Class
    source: str = ""  # import path of a recording, e.g. drivers.datasets:VideoFile
    path: str = ""  # the recording's file or folder
    source_options: Mapping[str, Any] = field(default_factory=dict)  # further keyword arguments
    size_px: tuple[int, int] = (0, 0)  # of the whole field; 0: the source's own
    context_scale: float = 0.25  # context side per field side
    roi_area: float = 0.0625  # share of the field that the ROI shows, aspect kept
    roi_scale: float = 1.0  # read-out side per ROI side
    rois: int = 1  # windows of `roi_area` each in one exposure, 1 to 4
    step_px: int = 0  # windows start at multiples of it; 0: 1, or 2 under a mosaic
    rate_hz: float = 0.0  # 0: the source's own
    seed: int = 0
    frames: int = 0  # exposures' worth of time; 0: all the source has
    loop: bool = False  # begin again where the source ends
    mosaic: bool = False  # a Bayer mosaic instead of RGB
    pixel_format: str = ""  # of the mosaic, as bayer_grbg12p; empty: bayer_rggb8
    noise: float = 0.0  # standard deviation, digital numbers of 8 bit
    full_well_e: float = 0.0  # mosaic: photon noise of so many electrons at white; 0: none
    read_noise_e: float = 0.0  # mosaic: noise of the electronics, electrons
    black_level: int = 0  # mosaic: digital numbers of its format in the dark
    gamma: float = 1.0  # mosaic: it counts the light, (picture / 255) ^ gamma
    latency_frames: int = 0  # a command from frame j affects j + 1 + latency_frames at the earliest
    budget: float = 0.125  # share of the full pixel rate
    strategy: Strategy = "foveated"
    oracle_label: str = "ball"
    full: bool = False  # also send the whole picture, for viewers; no part of the budget

    def __post_init__(self) -> None:
        if bool(self.scene) == bool(self.source):
            got = f"{self.scene!r} and {self.source!r}"
            raise SettingsError(f"scene or source: expected exactly one of them, got {got}")
        if self.strategy not in STRATEGIES:
            raise SettingsError(f"strategy: expected {', '.join(STRATEGIES)}, got {self.strategy}")
        for name in ("context_scale", "roi_area", "roi_scale", "budget"):
            if not 0 < getattr(self, name) <= 1:
                raise SettingsError(f"{name}: expected above 0 to 1, got {getattr(self, name)}")
        for name in ("step_px", "seed", "frames", "noise", "latency_frames", "rate_hz"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name}: must be at least 0, got {value}")
        self._check_raw()
        if self.mosaic and self.step_px % 2:
            raise SettingsError(f"step_px: a mosaic needs an even step, got {self.step_px}")
        if self.size_px != (0, 0) and not all(16 <= side <= 32_768 for side in self.size_px):
            raise SettingsError(f"size_px: expected sides of 16 to 32768, got {self.size_px}")
        self._check_rois()
        if self.source:
            given = {"path": self.path} if self.path else {}
            check_arguments("source", self.source, {**given, **self.source_options})
        else:
            scene_path(self.scene)
        if self.rate_hz and not RATES_HZ[0] <= self.rate_hz <= RATES_HZ[1]:
            low, high = RATES_HZ
            raise SettingsError(f"rate_hz: expected {low:g} to {high:g}, got {self.rate_hz}")

    def _check_rois(self) -> None:
        if not 1 <= self.rois <= MOST_ROIS:
            raise SettingsError(f"rois: expected 1 to {MOST_ROIS}, got {self.rois}")
        if self.rois > 1 and self.strategy != "foveated":
            raise SettingsError(
                f"rois: {self.strategy} reads one window at most, several need the strategy "
                f"foveated, got {self.rois}"
            )
        check_budget(
            self.strategy,
            self.budget,
            self.context_scale,
            self.roi_area,
            self.roi_scale,
            self.rois,
        )

    def _check_raw(self) -> None:
        usual = {"pixel_format": "", "full_well_e": 0, "read_noise_e": 0, "black_level": 0}
        for name, value in (usual | {"gamma": 1}).items():
            if not self.mosaic and getattr(self, name) != value:
                raise SettingsError(f"{name}: needs mosaic: true, got {getattr(self, name)}")
        if self.pixel_format and self.pixel_format not in MOSAICS:
            hint = suggest(self.pixel_format, MOSAICS)
            raise SettingsError(f"pixel_format: expected a mosaic, got {self.pixel_format}{hint}")
        if self.noise and self.full_well_e:
            raise SettingsError(
                f"noise: expected 0 beside full_well_e, which brings its own, got {self.noise}"
            )
        _ = self.response  # refuses what is out of range

    @property
    def form(self) -> PixelFormat:
        """What its frames carry."""
        return FORMATS[(self.pixel_format or "bayer_rggb8") if self.mosaic else "rgb8"]

    @property
    def response(self) -> Response:
        """How its pixels count light; raises `SettingsError` for what no sensor has."""
        return Response(
            bits=self.form.bits,
            black_level=self.black_level,
            gamma=self.gamma,
            full_well_e=self.full_well_e,
            read_noise_e=self.read_noise_e,
        )

    @property
    def share(self) -> float:
        """The effective budget; 1 for `full`."""
        return 1.0 if self.strategy == "full" else self.budget

    @property
    def multiple_px(self) -> int:
        """Sides and steps of a mosaic are whole cells of 2x2."""
        return 2 if self.mosaic else 1

    def sampling(self, size_px: tuple[int, int]) -> Sampling:
        """Return the sampling of a field of this size; raises `SettingsError` over the budget."""
        return sampling(
            self.strategy,
            size_px,
            budget=self.budget,
            context_scale=self.context_scale,
            roi_area=self.roi_area,
            roi_scale=self.roi_scale,
            multiple_px=self.multiple_px,
            rois=self.rois,
        )

    def geometry(self, size_px: tuple[int, int]) -> Geometry:
        """What every header tells of the sensor."""
        return geometry_of(
            size_px, roi_area=self.roi_area, step_px=self.step_px, multiple_px=self.multiple_px
        )
