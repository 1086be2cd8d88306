"""Read-out of a full picture by a foveating sensor: field and settings in, geometry and frames out.

Used by every sensor that cuts context and ROI from whole pictures: the simulated one and cameras.
"""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.commands import Commanded, Window
from drivers.sensor import Exposure
from drivers.source import Annotations
from pipeline.messages import Frame, Geometry, Header


def scaled(size_px: tuple[int, int], scale: float, multiple_px: int = 1) -> tuple[int, int]:
    """Both sides scaled to the nearest multiple, at least one and never beyond the original.

    >>> scaled((1920, 1080), 0.25), scaled((1920, 1080), 0.35355, 2)
    ((480, 270), (678, 382))
    """
    width, height = (
        min(side, max(multiple_px, round(side * scale / multiple_px) * multiple_px))
        for side in size_px
    )
    return width, height


def geometry_of(
    size_px: tuple[int, int], *, roi_area: float, step_px: int = 0, multiple_px: int = 1
) -> Geometry:
    """Geometry of a field whose ROI shows the share `roi_area` of it, aspect kept.

    >>> geometry_of((1920, 1080), roi_area=0.0625, step_px=8)
    Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270, step_px=8)
    """
    width, height = scaled(size_px, math.sqrt(roi_area), multiple_px)
    return Geometry(
        width_px=size_px[0],
        height_px=size_px[1],
        roi_width_px=width,
        roi_height_px=height,
        step_px=step_px or multiple_px,
    )


def average(region: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Fill `out` (h, w[, c]) with area means of a region with as many channels."""
    cv2.resize(region, (out.shape[1], out.shape[0]), dst=out, interpolation=cv2.INTER_AREA)


def exposure_of(
    header: Header,
    context: NDArray[Any],
    roi: NDArray[Any],
    aim: Commanded,
    *,
    pixel_format: str,
    roi_pixel_format: str = "",
    truth: Annotations | None = None,
) -> Exposure:
    """Both pictures as frames: the context shows the whole field, the ROI what `aim` says.

    A mosaic that is cropped at odd pixels has a format of its own, `roi_pixel_format`; empty: both
    frames have the same.
    """
    grid = header.geometry
    whole: Window = (0, 0, grid.width_px, grid.height_px)
    return Exposure(
        header=header,
        context=Frame(header=header, pixels=context, pixel_format=pixel_format, window=whole),
        roi=roi_frame(header, roi, aim, roi_pixel_format or pixel_format),
        truth=truth,
    )


def roi_frame(header: Header, pixels: NDArray[Any], aim: Commanded, pixel_format: str) -> Frame:
    """One window of an exposure as a frame."""
    return Frame(
        header=header,
        pixels=pixels,
        pixel_format=pixel_format,
        window=aim.window,
        command_seq=aim.command_seq,
        status=aim.status,
    )
