"""Show a running graph in Rerun: its messages -> pictures, boxes, paths and latencies.

The only module that imports Rerun. It sends nothing and is connected by taps: when it is too slow,
frames are missing in the view, never in the graph. Everything is drawn in sensor pixels under
`sensor`.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from subprocess import Popen
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from operators.visualise.server import await_listener, serve
from pipeline.boxes import centres
from pipeline.contract import INCOMPLETE, Input, Operator
from pipeline.errors import MessageError, RunError, SettingsError
from pipeline.growing_file import GrowingFile, never_collect
from pipeline.messages import (
    Detections,
    Frame,
    Header,
    Message,
    Percept,
    RoiSchedule,
    Scanpath,
    Tracks,
)
from pipeline.pixel_formats import FORMATS

TRAIL_FRAMES = 30
WHITE, YELLOW, GREY, RED = (255, 255, 255), (255, 210, 0), (150, 150, 150), (255, 60, 60)


@dataclass(frozen=True, kw_only=True)
class VisualiseSettings:
    """What a graph may set; at least one of save, connect and serve."""

    save: str = ""  # path of an .rrd file
    connect: str = ""  # of a viewer, e.g. rerun+http://127.0.0.1:9876/proxy
    serve: bool = False  # a viewer in the browser of this machine: loopback only
    port: int = 9876  # serve: where viewers fetch the data
    web_port: int = 9090  # serve: where the browser looks
    every: int = 1  # frames: show each n-th
    jpeg_quality: int = 80

    def __post_init__(self) -> None:
        if self.connect and self.serve:
            raise SettingsError("connect: expected one of connect and serve, got both")
        if self.every < 1:
            raise SettingsError(f"every: must be at least 1, got {self.every}")
        if not 1 <= self.jpeg_quality <= 100:
            raise SettingsError(f"jpeg_quality: must be within 1..100, got {self.jpeg_quality}")
        for name in ("port", "web_port"):
            if not 1 <= getattr(self, name) <= 65535:
                raise SettingsError(f"{name}: must be within 1..65535, got {getattr(self, name)}")


class Visualise(Operator[VisualiseSettings, None]):
    """Shows the connected inputs, all of which are optional. Memory use is bounded."""

    context = Input(Frame, join=False, optional=True, tap=True)
    roi = Input(Frame, join=False, optional=True, tap=True)
    roi_2 = Input(Frame, join=False, optional=True, tap=True)
    roi_3 = Input(Frame, join=False, optional=True, tap=True)
    roi_4 = Input(Frame, join=False, optional=True, tap=True)
    detections = Input(Detections, join=False, optional=True, tap=True)
    tracks = Input(Tracks, join=False, optional=True, tap=True)
    scanpath = Input(Scanpath, join=False, optional=True, tap=True)
    schedule = Input(RoiSchedule, join=False, optional=True, tap=True)
    percept = Input(Percept, join=False, optional=True, tap=True)

    _recording: rr.RecordingStream | None = None
    _file: GrowingFile | None = None
    _server: Popen[bytes] | None = None

    def open(self) -> None:
        """Open the file, the connection or the server; raises `RunError` when that fails."""
        s = self.settings
        if not (s.save or s.connect or s.serve):
            # not in the settings themselves: a graph may hold a viewer that is not started
            raise SettingsError("visualise.save: expected save, connect or serve, got none")
        self._trails: dict[int, deque[NDArray[np.float32]]] = {}
        url = f"rerun+http://127.0.0.1:{s.port}/proxy" if s.serve else s.connect
        if s.serve:
            self._server = serve(s.port, s.web_port)
        if url:
            await_listener(url)
        self._newest: int | None = None  # frame
        self._recording = record(s.save, url)
        if s.save:
            self._file = GrowingFile(Path(s.save).absolute(), partial(flushed, self._recording))

    def state(self) -> None:
        """Return None: trails grow again."""

    def summary(self) -> Mapping[str, Any]:
        """Return whether the recording is complete and, if not, up to which frame."""
        if self._file is not None:
            self._file.look(self._newest)
            if self._file.failure:
                return {INCOMPLETE: f"visualise.save: {self._file.failure}"}
        return {}

    def close(self) -> None:
        """Flush the recording and end the server; raises `RunError` if data was lost."""
        recording, self._recording = self._recording, None
        late = ""  # what went wrong after the summary
        if recording is not None and self._file is not None:
            late = self._file.close(recording.disconnect)
            if not self._file.ended:
                never_collect(recording)
                rr.unregister_shutdown()  # it would wait for the same writer
        elif recording is not None:
            recording.disconnect()
        if self._server is not None:
            self._server.terminate()
            self._server.wait()
        if late:
            raise RunError(f"visualise.save: {late}")

    def on_stream(self, header: Header) -> None:
        """Tell that a sensor was opened; old trails belong to other objects."""
        self._trails.clear()
        self._at(header)
        self._log("events", rr.TextLog(f"stream {header.stream} opened"))

    def on_context(self, context: Frame) -> None:
        """The whole field, enlarged to sensor pixels."""
        if self._wanted(context):
            self._picture("sensor/context", context)

    def on_roi(self, roi: Frame) -> None:
        """The ROI where it lies, with its rim."""
        self._window("roi", roi)

    def on_roi_2(self, roi_2: Frame) -> None:
        """The second window of a sensor that reads several."""
        self._window("roi_2", roi_2)

    def on_roi_3(self, roi_3: Frame) -> None:
        """The third window."""
        self._window("roi_3", roi_3)

    def on_roi_4(self, roi_4: Frame) -> None:
        """The fourth window."""
        self._window("roi_4", roi_4)

    def on_detections(self, detections: Detections) -> None:
        """Boxes with class and score."""
        if self._wanted(detections):
            labels = named(detections.names, detections.labels, detections.scores)
            self._boxes("sensor/detections", detections.boxes, GREY, labels)

    def on_tracks(self, tracks: Tracks) -> None:
        """Boxes with class and id, where they came from, where they are foreseen."""
        at = centres(tracks.boxes[:, -1])
        self._trails = {
            int(i): self._trails.get(int(i), deque(maxlen=TRAIL_FRAMES)) for i in tracks.ids
        }
        for i, centre in zip(tracks.ids, at, strict=True):
            self._trails[int(i)].append(centre)
        if not self._wanted(tracks):
            return
        labels = [
            f"{name} #{i}"
            for name, i in zip(named(tracks.names, tracks.labels), tracks.ids, strict=True)
        ]
        ids = tracks.ids.astype(np.uint16)  # Rerun gives each id a colour of its own
        self._boxes("sensor/tracks", tracks.boxes[:, -1], None, labels, ids)
        trails = [np.array(trail) for trail in self._trails.values()]
        self._lines("sensor/tracks/trails", trails, None, ids)
        self._lines("sensor/tracks/foreseen", list(centres(tracks.predicted)), GREY)

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Where the policy looks next, and its way from there."""
        if self._wanted(scanpath):
            labels = [f"look at #{i}" if i >= 0 else "look here" for i in scanpath.choice[:1]]
            self._boxes("sensor/scanpath", scanpath.boxes[:1], WHITE, labels)
            self._lines("sensor/scanpath/way", [centres(scanpath.boxes)], WHITE)

    def on_schedule(self, schedule: RoiSchedule) -> None:
        """The windows the sensor was told."""
        if self._wanted(schedule) and len(schedule.windows):
            windows = schedule.windows.reshape(len(schedule.windows), -1, 4)
            frames, places = np.nonzero(windows[..., 2] > windows[..., 0])
            labels = [str(schedule.first_seq + k) for k in frames]
            told = windows[frames, places].astype(np.float32)
            self._boxes("sensor/schedule", told, YELLOW, labels)

    def on_percept(self, percept: Percept) -> None:
        """What the consumer saw, read or did."""
        if not self._wanted(percept):
            return
        labels = [f"{score:.2f}" for score in percept.scores]
        if len(percept.texts) == len(labels):
            labels = list(percept.texts)
        self._boxes("sensor/percept", percept.boxes, RED, labels)
        if percept.texts:
            self._log("texts", rr.TextLog(" | ".join(percept.texts)))
        if len(percept.action):
            self._log("action", rr.Scalars(percept.action))

    @property
    def _out(self) -> rr.RecordingStream:
        if self._recording is None:
            raise RunError("visualise: expected to be open, got a message before that")
        return self._recording

    def _at(self, header: Header) -> None:
        self._out.set_time("frame", sequence=header.seq)
        self._out.set_time("stamp", duration=np.timedelta64(header.stamp_ns, "ns"))

    def _window(self, name: str, frame: Frame) -> None:
        """Show one ROI where it lies, with its rim."""
        if self._wanted(frame):
            self._picture(f"sensor/{name}", frame)
            rim = np.array([frame.window] if frame.pixels.size else [], np.float32)
            self._boxes(f"sensor/{name}_window", rim, YELLOW, [frame.status])

    def _wanted(self, message: Message) -> bool:
        """Whether this frame is shown; if so, sets the time and tells how its stage did."""
        if message.header.seq % self.settings.every:
            return False
        if self._file is not None and not self._file.is_written(self._newest):
            return False  # what cannot be written is not kept in memory either
        self._at(message.header)
        self._newest = message.header.seq
        for name, value in latencies(message.header).items():
            self._log(f"latency/{name}", rr.Scalars(value))
        return True

    def _log(self, path: str, what: Any) -> None:
        self._out.log(path, what)

    def _picture(self, path: str, frame: Frame) -> None:
        if not frame.pixels.size:
            self._log(path, rr.Clear(recursive=False))
            return
        left, top, right, bottom = frame.window
        width, height = frame.size_px
        scale = ((right - left) / width, (bottom - top) / height, 1.0)
        self._log(path, rr.Transform3D(translation=(left, top, 0), scale=scale))
        contents = jpeg(frame, self.settings.jpeg_quality)
        self._log(path, rr.EncodedImage(contents=contents, media_type="image/jpeg"))

    def _boxes(
        self,
        path: str,
        boxes: NDArray[np.float32],
        colour: tuple[int, int, int] | None,
        labels: list[str],
        ids: NDArray[np.uint16] | None = None,
    ) -> None:
        shown = rr.Boxes2D(
            array=boxes.reshape(-1, 4),
            array_format=rr.Box2DFormat.XYXY,
            colors=colour,
            labels=labels[: len(boxes)],
            class_ids=ids,
        )
        self._log(path, shown)

    def _lines(
        self,
        path: str,
        lines: list[NDArray[np.float32]],
        colour: tuple[int, int, int] | None,
        ids: NDArray[np.uint16] | None = None,
    ) -> None:
        self._log(path, rr.LineStrips2D(lines, colors=colour, class_ids=ids))


def latencies(header: Header) -> dict[str, float]:
    """What the last stage did with this exposure, in ms: name -> value; empty without a trace.

    `age` is the time since the picture was ready, given only where both are one clock.
    """
    if not header.trace:
        return {}
    span = header.trace[-1]
    shown = {"handler_ms": span.handler_ns / 1e6, "sched_delay_ms": span.scheduling_delay_ns / 1e6}
    if header.clock == "monotonic":
        shown["age_ms"] = (span.done_ns - header.stamp_ns) / 1e6
    if len(header.trace) > 1:
        shown["hop_ms"] = (span.received_ns - header.trace[-2].done_ns) / 1e6
    return {f"{span.stage}/{name}": value for name, value in shown.items()}


def named(
    names: tuple[str, ...], labels: NDArray[np.int32], scores: NDArray[np.float32] | None = None
) -> list[str]:
    """A text per object: its class and, if given, its score.

    >>> named(("ball",), np.array([0, 7], np.int32), np.array([0.5, 0.25], np.float32))
    ['ball 0.50', 'class 7 0.25']
    """
    texts = [names[i] if 0 <= i < len(names) else f"class {i}" for i in labels]
    if scores is None:
        return texts
    return [f"{text} {score:.2f}" for text, score in zip(texts, scores, strict=True)]


def jpeg(frame: Frame, quality: int) -> bytes:
    """A frame as JPEG; raises `MessageError` for a pixel format that cannot be shown as it is."""
    form = FORMATS.get(frame.pixel_format)
    if form is None or form.packed:
        raise MessageError(
            f"visualise: expected pixels as rgb8, grey8 or an unpacked mosaic, got "
            f"{frame.pixel_format}; put operators.downsample before it"
        )
    form.check("visualise", frame.pixels)
    pixels = frame.pixels
    if form.bits > 8:
        pixels = (pixels >> form.bits - 8).astype(np.uint8)
    if form.order:
        how = getattr(cv2, f"COLOR_Bayer{form.order.upper()}2BGR")
        pixels = np.asarray(cv2.cvtColor(pixels, how), np.uint8)
    elif form.name == "rgb8":
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), np.uint8)
    _, contents = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return contents.tobytes()


def record(path: str, url: str) -> rr.RecordingStream:
    """A recording that goes to a file, to a viewer or to both, with its panels."""
    recording = rr.RecordingStream("fovea")
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)  # the frame's own times are told instead
    sinks: list[Any] = [rr.GrpcSink(url)] if url else []
    if path:
        if not (folder := Path(path).absolute().parent).is_dir():
            raise RunError(f"visualise.save: expected a folder {folder}, got none")
        sinks.append(rr.FileSink(path))
    try:
        recording.set_sinks(*sinks, default_blueprint=panels())
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


def panels() -> rrb.Blueprint:
    """The field with everything on it, the ROI by itself, latencies, and what was read."""
    field = rrb.Spatial2DView(origin="sensor", name="field")
    roi = rrb.Spatial2DView(origin="sensor/roi", name="ROI")
    figures = rrb.TimeSeriesView(origin="latency", name="latency, ms")
    words = rrb.TextLogView(origin="/", contents=["texts", "events"], name="texts")
    side = rrb.Vertical(roi, figures, words, row_shares=[3, 3, 1])
    return rrb.Blueprint(rrb.Horizontal(field, side, column_shares=[3, 2]))
