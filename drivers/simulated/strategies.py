"""Sampling strategies for a pixel budget: settings and field size in, sampling out.

All strategies of the paper (Table 1 and supplement) are measured in the same way: pixels emitted
per exposure divided by full-resolution pixels of the source time that it covers.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from drivers.readout import scaled
from pipeline.errors import SettingsError

Strategy = Literal[
    "foveated",  # context and a commanded ROI (Eq. 1)
    "centred",  # the ROI stays in the middle
    "round_robin",  # the ROI tours the field
    "oracle",  # the ROI sits on the true place of one label
    "full",  # everything: no budget
    "spatial",  # the whole field, area-downsampled
    "temporal",  # the whole field at full resolution, frames left out
    "exposure",  # the whole field at full resolution, frames averaged: a longer exposure
]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
WITH_ROI = ("foveated", "centred", "round_robin", "oracle")
TOLERANCE = 0.01  # sides are whole pixels, so a budget is met to about this share


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """What is read of every `interval` source frames."""

    context_px: tuple[int, int]  # width, height of the whole-field picture
    window_px: tuple[int, int]  # the ROI on the sensor; (0, 0): none
    roi_px: tuple[int, int]  # the ROI as read
    interval: int = 1  # source frames per exposure
    averaged: bool = False  # the exposure integrates all of them; otherwise it is the first
    rois: int = 1  # windows of one exposure, each of `roi_px`

    def emitted_px(self, rois: int | None = None) -> int:
        """Pixels of one exposure with `rois` windows; None: with as many as it may read."""
        count = self.rois if rois is None else rois
        return math.prod(self.context_px) + count * math.prod(self.roi_px)


def sampling(
    strategy: Strategy,
    size_px: tuple[int, int],
    *,
    budget: float,
    context_scale: float,
    roi_area: float,
    roi_scale: float,
    multiple_px: int = 1,
    rois: int = 1,
) -> Sampling:
    """The sampling of a field of `size_px`; sides are multiples of `multiple_px`.

    `rois` windows of `roi_area` each share the budget.

    Raises `SettingsError` with the figures when the budget cannot be met.
    """
    check_budget(strategy, budget, context_scale, roi_area, roi_scale, rois)
    none = (0, 0)
    if strategy == "full":
        return Sampling(context_px=size_px, window_px=none, roi_px=none)
    if strategy == "spatial":
        context_px = scaled(size_px, math.sqrt(budget), multiple_px)
        return Sampling(context_px=context_px, window_px=none, roi_px=none)
    if strategy in ("temporal", "exposure"):
        return Sampling(
            context_px=size_px,
            window_px=none,
            roi_px=none,
            interval=round(1 / budget),
            averaged=strategy == "exposure",
        )
    window_px = scaled(size_px, math.sqrt(roi_area), multiple_px)
    found = Sampling(
        context_px=scaled(size_px, context_scale, multiple_px),
        window_px=window_px,
        roi_px=scaled(window_px, roi_scale, multiple_px),
        rois=rois,
    )
    used = found.emitted_px() / math.prod(size_px)
    if used > budget * (1 + TOLERANCE):
        raise SettingsError(
            f"budget: context {_by(found.context_px)} and {_windows(rois)}ROI {_by(found.roi_px)} "
            f"take {used:.4g} of {_by(size_px)}, expected at most {budget:.4g}"
        )
    return found


def check_budget(
    strategy: Strategy,
    budget: float,
    context_scale: float,
    roi_area: float,
    roi_scale: float,
    rois: int = 1,
) -> None:
    """Raise `SettingsError` where no field size could meet the budget."""
    if strategy in ("temporal", "exposure"):
        frames = round(1 / budget)
        if abs(frames * budget - 1) > TOLERANCE:
            raise SettingsError(
                f"budget: {strategy} needs 1 over a whole number of frames, got {budget:.4g}, "
                f"which is 1/{1 / budget:.4g}"
            )
    if strategy in WITH_ROI:
        context, roi = context_scale**2, rois * roi_area * roi_scale**2
        if context + roi > budget * (1 + TOLERANCE):
            raise SettingsError(
                f"budget: context {context:.4g} and {_windows(rois)}ROI {roi:.4g} take "
                f"{context + roi:.4g} of the field, expected at most {budget:.4g}"
            )


def _windows(rois: int) -> str:
    return f"{rois} windows of the " if rois > 1 else ""


def _by(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
