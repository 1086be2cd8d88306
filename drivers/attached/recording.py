"""The contract of a sensor that records: previews, a plan, its burst, previews again.

Such a sensor passes numbers over between previews and has an ROI only in the frames of a plan, so
what a live one is asked would find fault with what is right.
"""

from itertools import pairwise

import numpy as np

from drivers.contract import (
    Check,
    ContractBroken,
    Figures,
    Make,
    check_addressable,
    check_closing_is_safe_after_any_outcome,
    check_each_opening_is_a_new_stream,
    check_pictures_lie_in_the_memory_lent,
    command,
    read,
    running,
)
from drivers.sensor import DualStreamSensor, Exposure
from pipeline.boxes import roi_window

PREVIEWS = 3
PLANNED = 8  # frames of the plan
PATIENCE = 32  # exposures in which its first frame has to come
MODE = "record"  # value of the option `mode` of a sensor that is checked so


def check_previews_show_the_whole_field(make: Make) -> Figures:
    """Without a plan contexts come, in order, and no ROI."""
    with running(make) as sensor:
        can = sensor.capabilities()
        seen = [read(sensor) for _ in range(PREVIEWS)]
    whole = (0, 0, can.geometry.width_px, can.geometry.height_px)
    for exposure in seen:
        if exposure.roi.pixels.size:
            raise ContractBroken("preview: expected no ROI without a plan, got one")
        if (exposure.context.window, exposure.context.size_px) != (whole, can.context_px):
            raise ContractBroken(
                f"preview: expected {can.context_px} pixels of {whole}, got "
                f"{exposure.context.size_px} of {exposure.context.window}"
            )
    seqs = [exposure.header.seq for exposure in seen]
    _check_order(seen)
    return {"frames_per_preview": (seqs[-1] - seqs[0]) / (len(seqs) - 1)}


def check_a_plan_is_recorded_frame_by_frame(make: Make) -> Figures:
    """Each frame of a plan comes with its window, then previews go on."""
    with running(make) as sensor:
        can = sensor.capabilities()
        if not can.roi_sizes_px:
            raise ContractBroken("roi_sizes_px: expected a size to record, got none")
        grid = can.geometry
        header = read(sensor).header
        first = header.seq + max(can.lead_frames, 1) + 1
        ends = np.array([[0, 0], [grid.width_px, grid.height_px]], np.float32)
        windows = [roi_window(ends[k % 2], grid) for k in range(PLANNED)]
        sensor.set_rois(command(header.stream, made_from=header.seq, first=first, windows=windows))
        burst, after = _burst(sensor)
    _check_order([*burst, after])
    for exposure in burst:
        roi, number = exposure.roi, exposure.header.seq - first
        wanted = windows[number] if 0 <= number < PLANNED else None
        if (roi.window, roi.command_seq) != (wanted, header.seq):
            raise ContractBroken(
                f"frame {number} of the plan: expected the window {wanted} of command "
                f"{header.seq}, got {roi.window} of {roi.command_seq}"
            )
        check_addressable(roi.window, grid)
    if len(burst) != PLANNED:
        raise ContractBroken(f"burst: expected {PLANNED} frames, got {len(burst)}")
    return {"frames": len(burst), "first_after": burst[0].header.seq - header.seq}


RECORDING: tuple[Check, ...] = (
    check_previews_show_the_whole_field,
    check_each_opening_is_a_new_stream,
    check_a_plan_is_recorded_frame_by_frame,
    check_pictures_lie_in_the_memory_lent,
    check_closing_is_safe_after_any_outcome,
)


def _burst(sensor: DualStreamSensor) -> tuple[list[Exposure], Exposure]:
    """Read until a plan is recorded; return its frames and the preview after them."""
    burst: list[Exposure] = []
    for _ in range(PATIENCE + PLANNED):
        exposure = read(sensor)
        if exposure.roi.pixels.size:
            burst.append(exposure)
        elif burst:
            return burst, exposure
    raise ContractBroken(
        f"plan: expected its {PLANNED} frames and a preview within {PATIENCE + PLANNED} exposures, "
        f"got {len(burst)} frames of it"
    )


def _check_order(seen: list[Exposure]) -> None:
    headers = [exposure.header for exposure in seen]
    for one, other in pairwise(headers):
        if not (one.seq < other.seq and one.stamp_ns < other.stamp_ns):
            raise ContractBroken(
                f"order: expected a frame after number {one.seq} at {one.stamp_ns} ns, got number "
                f"{other.seq} at {other.stamp_ns} ns"
            )
