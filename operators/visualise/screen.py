"""Rerun: a recording in a file, a viewer or a browser, what is drawn there, and its layout.

With `layout` and `beside` the only importer of Rerun. The entity paths are listed in the README.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from subprocess import Popen
from threading import Thread
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from operators.visualise.glance import Glance
from operators.visualise.held import Held
from operators.visualise.layout import layout
from operators.visualise.server import Audience, await_listener, serve
from operators.visualise.shown import Shown
from pipeline.errors import RunError
from pipeline.growing_file import CLOSE_S, GrowingFile, never_collect

THIN, BOLD, RIM = (rr.Radius.ui_points(points) for points in (0.75, 1.5, 2.0))
Drawn = tuple[tuple[int, int], str | list[object], Any]  # frame and ns, entity, what is logged
LINES = {  # entity -> name and colour of its line
    "latency/loop/p50": ("p50", (60, 150, 220)),
    "latency/loop/p99": ("p99", (240, 110, 0)),
    "latency/loop/budget_p50": ("budget of p50", (120, 150, 180)),
    "latency/loop/budget_p99": ("budget of p99", (190, 150, 120)),
    "figures/pixels/read": ("read, % of the sensor", (60, 150, 220)),
    "figures/pixels/budget": ("budget, %", (120, 150, 180)),
    "figures/target/in_roi": ("share inside the ROI", (225, 160, 0)),
    "figures/target/iou": ("IoU with the truth", (255, 60, 60)),
    "figures/action_change": ("largest change of a value of the action", (60, 150, 220)),
}
LEGEND = """\
**Bright yellow**: the ROI, read at full resolution in this frame; at the right, beside what the
context alone shows there. **Dark yellow**: windows planned, +1 for the next frame.

**Boxes**: what is tracked, a colour for each class, dark in doubt; a line is its predicted path.
**Bold with a name**: the target. **Red**: the consumer's answer. **Dashed**: the truth.

**Policy**: how probable it is that it looks at an object; right of the line: its plan.
"""


class Screen:
    """One recording; every method after `open` may be called at any rate."""

    def __init__(self, save: str, connect: str, server_ports: tuple[int, int] | None) -> None:
        """Open the file, the connection or the server; raises `RunError` when that fails."""
        self._server: Popen[bytes] | None = None
        self._file: GrowingFile | None = None
        if server_ports is not None:
            self._server = serve(*server_ports)
            connect = f"rerun+http://127.0.0.1:{server_ports[0]}/proxy"
        try:
            if connect:
                await_listener(connect)
            self._recording = record(save, connect)
        except RunError:
            self._end_server()
            raise
        flush = partial(flushed, self._recording)
        self._audience = Audience(self._server, flush) if connect else None
        if save:
            self._file = GrowingFile(Path(save).absolute(), flush)
        self._held: Held[Drawn] = Held()
        self._now = (0, 0)  # frame, ns since the start of the stream
        self._newest: int | None = None  # frame that was sent
        self._shown: Shown | None = None
        self._glance = Glance()
        for path, (name, colour) in LINES.items():
            self._recording.log(path, rr.SeriesLines(names=name, colors=colour), static=True)

    def wanted(self) -> bool:
        """Return whether to draw: somebody watches, and takes what is sent; or a file does.

        What cannot be written is not kept in memory either.
        """
        if self._file is not None and not self._file.is_written(self._newest):
            return False
        return self.takes() and (
            self._audience is None or self._file is not None or self._audience.watches
        )

    def takes(self) -> bool:
        """Return whether what is sent arrives, so that a line of text may be sent."""
        if self._file is not None and self._file.failure:
            return False
        if self._audience is None:
            return True
        self._audience.look()
        return self._audience.takes

    def failure(self) -> str:
        """Return why the file is not complete, as a sentence; empty when it is."""
        if self._file is None:
            return ""
        self.send_all()
        self._file.look(self._newest)
        return self._file.failure

    def close(self) -> str:
        """End recording and server; return what was lost meanwhile, as a sentence."""
        late, recording = "", self._recording
        if self.takes():
            self.send_all()
        if self._file is not None:
            late = self._file.close(recording.disconnect)
            ended = self._file.ended
        else:
            ending = Thread(target=recording.disconnect, daemon=True)  # a stalled viewer blocks it
            ending.start()
            ending.join(CLOSE_S)
            ended = not ending.is_alive()
        if not ended:
            never_collect(recording)
            rr.unregister_shutdown()  # it would wait for the same writer
        self._end_server()
        return late

    def at(self, frame: int, since_start_ns: int, source: str = "") -> None:
        """Set the time of what is drawn next, and send what is complete.

        `source` is an input, whose frames come in order.
        """
        self._now = frame, since_start_ns
        if source:
            self._send(self._held.complete())
            self._held.arrived(frame, source)
            if self._glance.is_due(since_start_ns):
                text = f"{self._glance.text()}\n\n{LEGEND}"
                self._log("legend", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def send_all(self) -> None:
        """Send what is held; a new stream may begin."""
        self._send(self._held.all())

    def picture(
        self,
        path: str,
        contents: bytes,
        window: Sequence[int],
        size_px: tuple[int, int],
        order: int,
    ) -> None:  # fmt: skip
        """Draw a JPEG of `size_px` where its window lies; a higher `order` covers lower ones."""
        left, top, right, bottom = window
        scale = ((right - left) / size_px[0], (bottom - top) / size_px[1], 1.0)
        self._log(path, rr.Transform3D(translation=(left, top, 0), scale=scale))
        image = rr.EncodedImage(contents=contents, media_type="image/jpeg", draw_order=order)
        self._log(path, image)

    def clear(self, path: str) -> None:
        """Remove what was drawn under a path."""
        self._log(path, rr.Clear(recursive=False))

    def boxes(
        self, path: str, boxes: NDArray[np.float32], colours: Any, labels: Sequence[str] = (),
        *, radius: Any = THIN, named: bool = False,
    ) -> None:  # fmt: skip
        """Draw boxes (n, 4) of the field. Labels are shown if `named`, else on hovering only."""
        shown = rr.Boxes2D(
            array=boxes.reshape(-1, 4), array_format=rr.Box2DFormat.XYXY, colors=colours,
            labels=labels[: len(boxes)], show_labels=named, radii=radius, draw_order=30.0,
        )  # fmt: skip
        self._log(path, shown)

    def lines(
        self, path: str, lines: Sequence[Any] | NDArray[np.float32], colours: Any,
        *, radius: Any = THIN,
    ) -> None:  # fmt: skip
        """Draw lines, each of (points, 2)."""
        self._log(path, rr.LineStrips2D(lines, colors=colours, radii=radius, draw_order=20.0))

    def texts(
        self, path: str, places: NDArray[np.float32], texts: Sequence[str],
        colour: tuple[int, int, int] | NDArray[np.uint8],
    ) -> None:  # fmt: skip
        """Write short texts at points (n, 2), in one colour or each in its own."""
        dots = rr.Points2D(places, labels=texts, show_labels=True, radii=THIN, colors=colour)
        self._log(path, dots)

    def cells(self, path: str, colours: NDArray[np.uint8], cell: tuple[int, int]) -> None:
        """Draw one rectangle of `cell` (width, height) for each pixel of (rows, columns, 3)."""
        if not colours.size:
            self.clear(path)
            return
        self._log(path, rr.Transform3D(scale=(*cell, 1.0)))
        self._log(path, rr.Image(colours, magnification_filter="nearest"))

    def value(self, path: str | list[object], *values: float) -> None:
        """Plot one value, or several as lines of their own."""
        self._log(path, rr.Scalars(values))
        self._glance.add(path, values[0])

    def aim(self, target: str) -> None:
        """Take the name of what the policy looks at, empty for none."""
        self._glance.target = target

    def line(self, text: str, level: str = "INFO") -> None:
        """Add a line to the log, at once."""
        self._send(iter([(self._now[0], [(self._now, "log", rr.TextLog(text, level=level))])]))

    def lay_out(self, shown: Shown) -> None:
        """Lay the panels out for what there is to show."""
        if self._shown != shown:
            self._shown = shown
            self._recording.send_blueprint(layout(shown))

    def _log(self, path: str | list[object], what: Any) -> None:
        self._held.add(self._now[0], (self._now, path, what))

    def _send(self, frames: Iterator[tuple[int, list["Drawn"]]]) -> None:
        for _frame, drawn in frames:
            for (frame, since_start_ns), path, what in drawn:
                self._recording.set_time("frame", sequence=frame)
                self._recording.set_time("time", duration=np.timedelta64(since_start_ns, "ns"))
                self._recording.log(path, what)
                self._newest = frame if path != "log" else self._newest

    def _end_server(self) -> None:
        if self._server is not None:
            self._server.terminate()
            self._server.wait()


def record(path: str, url: str) -> rr.RecordingStream:
    """A recording that goes to a file, to a viewer or to both, with its layout."""
    recording = rr.RecordingStream("fovea")
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)  # the frame's own times are told instead
    sinks: list[Any] = [rr.GrpcSink(url)] if url else []
    if path:
        if not (folder := Path(path).absolute().parent).is_dir():
            raise RunError(f"visualise.save: expected a folder {folder}, got none")
        sinks.append(rr.FileSink(path))
    try:
        recording.set_sinks(*sinks, default_blueprint=layout(Shown()))
    except RuntimeError as error:
        raise RunError(f"visualise.save: {path} cannot be written: {error}") from error
    return recording


def flushed(recording: rr.RecordingStream, timeout_s: float) -> bool:
    """Wait until everything that was logged has been written; whether it was, in that time."""
    try:
        recording.flush(timeout_sec=timeout_s)
    except RuntimeError:
        return False
    return True
