"""Recordings of runs on the same light -> one recording that shows them in columns."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from operators.visualise.layout import collapsed_panels, log, pair, plot
from pipeline.errors import RunError

MOST_COLUMNS = 4
MOST_CHARS = 60  # of a column's name
PROPERTIES = "/__properties"  # of one recording, not of what it shows


def write_beside(parts: Mapping[str, Path], out: Path) -> None:
    """Write one recording of several, by name; run k is below the path `try_k`, from 1 on.

    Frames of the same number are shown at once. Raises `RunError` when it cannot be written.
    """
    recording = rr.RecordingStream("fovea")
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)
    try:
        recording.set_sinks(rr.FileSink(out), default_blueprint=columns(tuple(parts)))
        for number, path in enumerate(parts.values(), 1):
            recording.send_chunks(_below(f"/try_{number}", path))
    except (RuntimeError, ValueError, OSError) as error:
        raise RunError(f"--save {out}: cannot be written: {error}") from error
    finally:
        recording.disconnect()


def columns(names: tuple[str, ...]) -> rrb.Blueprint:
    """A column for each run: the field, the ROI beside the context, the target, pixels."""
    if not 1 <= len(names) <= MOST_COLUMNS:
        raise RunError(f"--save: expected 1 to {MOST_COLUMNS} runs side by side, got {len(names)}")
    made = [_column(f"try_{number}", name) for number, name in enumerate(names, 1)]
    return rrb.Blueprint(
        rrb.Horizontal(*made), *collapsed_panels(), auto_views=False, auto_layout=False
    )


def _column(top: str, name: str) -> rrb.Vertical:
    cut = name if len(name) <= MOST_CHARS else f"{name[:MOST_CHARS]}…"
    return rrb.Vertical(
        rrb.Spatial2DView(origin=f"{top}/sensor", name=cut),
        rrb.Tabs(
            plot("target", f"{top}/figures/target", (0.0, 1.05)),
            plot("pixels", f"{top}/figures/pixels"),
            plot("action", f"{top}/action"),
            log(f"{top}/log", "what happened"),
        ),
        pair(f"{top}/sensor/roi", f"{top}/window/roi", "roi"),
        row_shares=[4, 2, 5],
    )


def _below(top: str, path: Path) -> Iterator[Chunk]:
    for chunk in RrdReader(path).stream():
        if not chunk.entity_path.startswith(PROPERTIES):
            yield chunk.with_entity_path(f"{top}{chunk.entity_path}")
