"""The layout of the view in Rerun: which paths each panel shows."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from operators.visualise.shown import Shown

SHOWN_FRAMES = 600  # of plots: the last ones
RASTER_PX = (-90, 260), (-16, 124)  # left to right, top to bottom; the names stand left of 0
STACK_PX = (-62, 300), (-10, 130)  # likewise; the scale stands left of 0, the names at the right


def layout(shown: Shown) -> rrb.Blueprint:
    """The field, the ROI beside its window in the context; below, the policy, figures, the log.

    On a second tab of the field: what is read, beside full resolution if it is known. What the
    consumer does comes first: its actions in place of the raster, or its texts in the log.
    """
    size_px = shown.size_px
    bounds = rrb.VisualBounds2D(x_range=(0, size_px[0]), y_range=(0, size_px[1]))
    field = rrb.Spatial2DView(
        origin="sensor", name="whole field, the ROI in place",
        visual_bounds=bounds if all(size_px) else None,
    )  # fmt: skip
    names = ["roi", *(f"roi_{k}" for k in range(2, shown.windows + 1))]
    pairs = [pair(f"sensor/{name}", f"window/{name}", name) for name in names]
    gain = pairs[0] if shown.windows == 1 else rrb.Tabs(*pairs)
    read = _foveated(names, bounds if all(size_px) else None, full=shown.full)
    above = rrb.Horizontal(rrb.Tabs(field, read), gain, column_shares=[5, 3])
    raster = rrb.Spatial2DView(
        origin="scanpath",
        name="policy: objects by frames",
        visual_bounds=rrb.VisualBounds2D(x_range=RASTER_PX[0], y_range=RASTER_PX[1]),
    )
    # what acts has no target: it is shown how much the action changes in its place
    moves = plot("action change", "figures/action_change")
    figures = [
        moves if shown.acts else plot("target", "figures/target", (0.0, 1.05)),
        plot("pixels", "figures/pixels"), plot("drops", "drops"),
    ]  # fmt: skip
    below = rrb.Horizontal(
        rrb.Tabs(plot("action", "action"), raster) if shown.acts else raster,
        rrb.Tabs(*_latency(details=shown.details)),
        rrb.Tabs(*figures),
        rrb.Tabs(
            rrb.TextDocumentView(origin="legend", name="what is drawn"),
            log("log", "texts and events" if shown.reads else "what happened"),
            active_tab=1 if shown.reads else 0,
        ),
        column_shares=[3, 3, 3, 3],
    )
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[5, 2]),
        *collapsed_panels(),
        auto_views=False,
        auto_layout=False,
    )


def _latency(*, details: bool) -> list[rrb.View]:
    stack = rrb.Spatial2DView(
        origin="latency/stack", name="by stage, ms",
        visual_bounds=rrb.VisualBounds2D(x_range=STACK_PX[0], y_range=STACK_PX[1]),
    )  # fmt: skip
    shown: list[rrb.View] = [plot("loop latency, ms", "latency/loop"), stack]
    ends = [plot("stages, ms", "latency/stages"), plot("details", "latency/each")]
    return [*shown, *ends] if details else shown


def collapsed_panels() -> tuple[rrb.TimePanel, rrb.SelectionPanel, rrb.BlueprintPanel]:
    """The panels beside the views, out of the way; the newest frame is shown."""
    return (
        rrb.TimePanel(state="collapsed", timeline="frame", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _foveated(
    names: Sequence[str], bounds: rrb.VisualBounds2D | None, *, full: bool
) -> rrb.Spatial2DView | rrb.Horizontal:  # fmt: skip
    """The context enlarged, the ROIs in place, nothing drawn over it; beside full resolution.

    The viewer composes it of the two pictures, so that it costs no picture of its own.
    """
    shown = rrb.Spatial2DView(
        origin="sensor", name="what is read", visual_bounds=bounds,
        contents=[f"$origin/{name}" for name in ("context", *names)],
    )  # fmt: skip
    if not full:
        return shown
    whole = rrb.Spatial2DView(origin="full", name="full resolution", visual_bounds=bounds)
    return rrb.Horizontal(shown, whole, name="what is read, beside full resolution")


def pair(roi: str, window: str, name: str) -> rrb.Vertical:
    """An ROI above the same window of the context, by their paths."""
    title = name.replace("roi", "ROI").replace("_", " ")
    return rrb.Vertical(
        rrb.Spatial2DView(origin=roi, contents="$origin", name=f"{title}, as read"),
        rrb.Spatial2DView(origin=window, name="the same window in the context"),
        name=title,
    )


def log(origin: str, name: str) -> rrb.TextLogView:
    """Lines of text with their frames; path and level, the same in all, would take half of it."""
    columns = rrb.archetypes.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"])
    return rrb.TextLogView(origin=origin, name=name, columns=columns)


def plot(name: str, origin: str, ends: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    """The last values below a path; `ends`: of the axis, else by the values."""
    last = rrb.VisibleTimeRange(
        "frame",
        start=rrb.TimeRangeBoundary.cursor_relative(seq=-SHOWN_FRAMES),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    axis = rrb.ScalarAxis(range=ends, zoom_lock=True) if ends else None
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis, time_ranges=last)
