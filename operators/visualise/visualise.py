"""Show a running graph in Rerun: its messages -> the loop at a glance.

It sends nothing and is connected by taps: when it is too slow, frames are missing in the view,
never in the graph. Everything on the field is drawn in sensor pixels, under `sensor`.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from operators.visualise import field
from operators.visualise.events import MOST_CHARS, Events
from operators.visualise.figures import LoopLatency, PixelsRead, Target, latencies, stages
from operators.visualise.pictures import encoded, jpeg, jpeg_within, same_window
from operators.visualise.raster import PAST_FRAMES, ScanpathRaster
from operators.visualise.shown import Shown
from operators.visualise.stack import StageStack, draw
from pipeline.boxes import centres
from pipeline.contract import INCOMPLETE, Input, Operator
from pipeline.errors import RunError, SettingsError
from pipeline.extras import LateModule, need
from pipeline.messages import (
    Detections,
    Frame,
    Header,
    Message,
    Percept,
    RoiSchedule,
    Scanpath,
    Tracks,
    Truth,
)

if TYPE_CHECKING:
    from operators.visualise import screen
else:  # it needs the extra `view`
    screen = LateModule("operators.visualise.screen")

TRAIL_FRAMES = 30
CELL = (4, 15)  # of the raster, width and height
STACK_EVERY = 5  # frames shown, between two pictures of the loop by stage
MOST_NAMES = 500  # of objects seen, for the raster
MOST_WINDOW_PX = 640  # width of what the context shows of an ROI
MOST_FULL_PX = 4096  # width of a full picture; larger ones are averaged
MOST_ACTIONS = 8  # values of an action; a robot is told a hundred steps of each joint at once
MOST_NOTES = 50  # of one call of `note`


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
    details: bool = False  # detections, trails, and series of each stage and object, too

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
    """Shows the connected inputs, all of which are optional. Memory use is bounded.

    Nothing is drawn or encoded while nobody watches, or while a viewer takes nothing.
    """

    live = ("every", "jpeg_quality", "details")
    commands = ("note",)
    context = Input(Frame, join=False, optional=True, tap=True)
    roi = Input(Frame, join=False, optional=True, tap=True)
    roi_2 = Input(Frame, join=False, optional=True, tap=True)
    roi_3 = Input(Frame, join=False, optional=True, tap=True)
    roi_4 = Input(Frame, join=False, optional=True, tap=True)
    full = Input(Frame, join=False, optional=True, tap=True)
    detections = Input(Detections, join=False, optional=True, tap=True)
    tracks = Input(Tracks, join=False, optional=True, tap=True)
    scanpath = Input(Scanpath, join=False, optional=True, tap=True)
    schedule = Input(RoiSchedule, join=False, optional=True, tap=True)
    percept = Input(Percept, join=False, optional=True, tap=True)
    truth = Input(Truth, join=False, optional=True, tap=True)

    _screen: "screen.Screen | None" = None
    _tracks: Tracks | None = None  # the newest
    _action: NDArray[np.float32]  # the newest
    _kinds: set[str]  # fields of `Shown` that were seen to hold

    @classmethod
    def advise(cls, settings: VisualiseSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `InstallError` without Rerun."""
        need("rerun", "visualise")
        return ()

    def open(self) -> None:
        """Open the file, the connection or the server; raises `RunError` when that fails."""
        s = self.settings
        if not (s.save or s.connect or s.serve):
            # not in the settings themselves: a graph may hold a viewer that is not started
            raise SettingsError("save: expected save, connect or serve, got none")
        self._begin()
        self._windows, self._kinds = {"roi"}, set()
        self._screen = screen.Screen(s.save, s.connect, (s.port, s.web_port) if s.serve else None)

    def state(self) -> None:
        """Return None: trails and figures grow again."""

    def summary(self) -> Mapping[str, Any]:
        """Return whether the recording is complete and, if not, up to which frame."""
        if self._screen is not None and (failure := self._screen.failure()):
            return {INCOMPLETE: f"visualise.save: {failure}"}
        return {}

    def close(self) -> None:
        """Flush the recording and end the server; raises `RunError` if data was lost."""
        own, self._screen = self._screen, None
        if own is not None and (late := own.close()):
            raise RunError(f"visualise.save: {late}")

    def do_note(self, lines: tuple[str, ...] = (), drops: Mapping[str, int] | None = None) -> None:
        """Add lines to the log and plot counts of drops, `EDGE/REASON` -> messages."""
        for line in lines[:MOST_NOTES] if self._out.takes() else ():
            self._out.line(line[:MOST_CHARS])
        if self._start_ns is not None and self._out.wanted():
            for name, count in list((drops or {}).items())[:MOST_NOTES]:
                self._out.value(["drops", *name.split("/")], count)

    def on_stream(self, header: Header) -> None:
        """Tell that a sensor was opened; what was known of objects belongs to other ones."""
        self._out.send_all()
        self._begin()
        self._at(header)
        self._say(header, [f"the sensor was opened: stream {header.stream}"])

    def on_context(self, context: Frame) -> None:
        """The whole field, enlarged to sensor pixels."""
        self._pixels.add_context(context)
        self._contexts[context.header.seq % len(self._contexts)] = context
        if self._wanted(context, "context"):
            self._picture("sensor/context", context, 0)
            for name in self._windows:
                self._draw_same_window(name, context, self._rois.get(name))

    def on_roi(self, roi: Frame) -> None:
        """The ROI where it lies, with its rim, and the same window of the context."""
        self._say(roi.header, self._events.read(roi))
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

    def on_full(self, full: Frame) -> None:
        """The whole field at full resolution, beside context and ROI."""
        if self._wanted(full, "full"):
            self._kinds.add("full")
            contents, size_px = jpeg_within(full, self.settings.jpeg_quality, MOST_FULL_PX)
            self._out.picture("full", contents, full.window, size_px, 0)

    def on_detections(self, detections: Detections) -> None:
        """Boxes with class and score, as details."""
        if self._wanted(detections, "detections") and self.settings.details:
            labels = field.named(detections.names, detections.labels, detections.scores)
            self._out.boxes("sensor/detections", detections.boxes, field.GREY, labels)

    def on_truth(self, truth: Truth) -> None:
        """The true boxes, dashed."""
        self._target.add_truth(truth)
        if self._wanted(truth, "truth"):
            self._out.lines("sensor/truth", field.dashed(truth.boxes), field.WHITE)

    def on_tracks(self, tracks: Tracks) -> None:
        """Boxes in the colours of their classes, where they are foreseen, the target by name."""
        self._grow_trails(tracks)
        self._tracks = tracks
        row, in_roi = self._target.row(tracks), self._target.in_roi(tracks)
        if len(self._names) > MOST_NAMES:
            self._names.clear()
        self._names |= {int(i): tracks.name_of(k) for k, i in enumerate(tracks.ids)}
        if not self._wanted(tracks, "tracks"):
            return
        names = field.named(tracks.names, tracks.labels)
        labels = [f"{name} #{i}" for name, i in zip(names, tracks.ids, strict=True)]
        colours, boxes = field.track_colours(tracks), tracks.boxes[:, -1]
        others = np.arange(len(boxes)) != row
        out = self._out
        out.boxes(
            "sensor/tracks", boxes[others], colours[others],
            [label for label, other in zip(labels, others, strict=True) if other],
        )  # fmt: skip
        out.lines("sensor/tracks/predicted", *field.paths(tracks))
        chosen = ~others
        out.boxes(
            "sensor/target", boxes[chosen], field.full(colours[chosen]),
            labels[row : row + 1] if row >= 0 else (), radius=screen.BOLD, named=True,
        )  # fmt: skip
        if in_roi is not None:
            out.value("figures/target/in_roi", in_roi)
        if self.settings.details:
            trails = [np.array(trail) for trail in self._trails.values()]
            out.lines("sensor/tracks/trails", trails, colours)
            for i, score in zip(tracks.ids, tracks.scores, strict=True):
                out.value(f"objects/{i}/score", float(score))

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Where the policy looks, frame by frame, as a raster of probabilities."""
        self._target.add_scanpath(scanpath)
        chosen = self._target.id
        name = f"{self._names.get(chosen) or 'object'} #{chosen}" if chosen >= 0 else ""
        self._say(scanpath.header, self._events.looked_at(name))
        self._out.aim(name)
        raster = self._raster.add(scanpath)
        if not self._wanted(scanpath, "scanpath"):
            return
        width, height = CELL
        self._out.cells("scanpath/raster", raster.shades, CELL)
        places = [(-45, k * height) for k in range(len(raster.ids))]
        texts = [f"{self._names.get(i, '')} #{i}" for i in raster.ids]
        at = np.array(places, np.float32).reshape(-1, 2)
        self._out.texts("scanpath/names", at, texts, field.WHITE)
        now = [(PAST_FRAMES * width, -height), (PAST_FRAMES * width, len(texts) * height)]
        self._out.lines("scanpath/now", [now], field.WHITE)
        if self.settings.details and len(scanpath.probability):
            for i, p in zip(scanpath.ids, scanpath.probability[0], strict=True):
                self._out.value(f"objects/{i}/probability", float(p))

    def on_schedule(self, schedule: RoiSchedule) -> None:
        """The windows the sensor was told, and how late the loop was."""
        self._loop.add(schedule.header)
        if not self._wanted(schedule, "schedule"):
            return
        if len(schedule.windows):
            boxes, colours, places, numbers = field.planned(schedule)
            self._out.boxes("sensor/planned", boxes, colours)
            self._out.texts("sensor/planned/numbers", places, numbers, field.YELLOW)
        figures = self._loop.figures()
        for name, value in figures.items():
            self._out.value(f"latency/loop/{name}", value)
        finished_ms = stages(schedule.header)
        for name, value in finished_ms.items():
            self._out.value(f"latency/stages/{name}", value)
        self._stack.add(finished_ms)
        if schedule.header.seq // self.settings.every % STACK_EVERY == 0:
            draw(self._stack, figures.get("budget_p50", 0.0), self._out)

    def on_percept(self, percept: Percept) -> None:
        """What the consumer saw, read or did."""
        self._say(percept.header, self._events.answered(percept))
        overlap = self._target.overlap(percept)
        if not self._wanted(percept, "percept"):
            return
        boxes, labels = percept.boxes, [f"{score:.2f}" for score in percept.scores]
        read = len(percept.texts) == len(labels) and bool(labels)
        if read:
            rows = field.on_tracks(boxes, self._tracks)
            boxes, labels = boxes[rows], [percept.texts[row] for row in rows]
        self._out.boxes("sensor/percept", boxes, field.RED, labels, named=read)
        if overlap is not None:
            self._out.value("figures/target/iou", overlap)
        if percept.texts:
            self._kinds.add("reads")
            self._say(percept.header, self._events.transcribed(percept.texts))
        if len(percept.action):
            self._kinds.add("acts")
            self._out.value("action", *map(float, percept.action[:MOST_ACTIONS]))
            if len(percept.action) == len(self._action):
                change = np.abs(percept.action - self._action).max()
                self._out.value("figures/action_change", float(change))
            self._action = percept.action

    @property
    def _out(self) -> "screen.Screen":
        if self._screen is None:
            raise RunError("visualise: expected to be open, got a message before that")
        return self._screen

    def _begin(self) -> None:
        """Know nothing of the stream."""
        self._trails: dict[int, deque[NDArray[np.float32]]] = {}
        self._loop, self._pixels, self._target = LoopLatency(), PixelsRead(), Target()
        self._raster, self._stack, self._events = ScanpathRaster(), StageStack(), Events()
        self._action = np.zeros(0, np.float32)
        self._names = dict[int, str]()  # of the tracks
        self._tracks = None
        self._start_ns: int | None = None
        self._contexts: list[Frame | None] = [None, None]  # the newest two
        self._rois: dict[str, Frame] = {}  # the newest of each window

    def _at(self, header: Header, source: str = "") -> None:
        if self._start_ns is None:
            self._start_ns = header.stamp_ns
        self._out.at(header.seq, header.stamp_ns - self._start_ns, source)

    def _window(self, name: str, frame: Frame) -> None:
        """Show one ROI where it lies, with its rim, and the same window of the context."""
        read = self._pixels.add_roi(name, frame)
        self._target.add_roi(name, frame)
        self._rois[name] = frame
        if not self._wanted(frame, name):
            return
        self._windows.add(name)
        geometry = frame.header.geometry
        size_px = (geometry.width_px, geometry.height_px)
        kinds = {name: name in self._kinds for name in ("full", "acts", "reads")}
        details = self.settings.details
        self._out.lay_out(Shown(len(self._windows), size_px, **kinds, details=details))
        self._picture(f"sensor/{name}", frame, 10)
        rim = np.array([frame.window] if frame.pixels.size else [], np.float32)
        self._out.boxes(f"sensor/{name}_rim", rim, field.YELLOW, [frame.status], radius=screen.RIM)
        for context in self._contexts:
            self._draw_same_window(name, context, frame)
        for what, percent in read.items():
            self._out.value(f"figures/pixels/{what}", percent)

    def _draw_same_window(self, name: str, context: Frame | None, roi: Frame | None) -> None:
        """Show the window of an ROI as the context of the same exposure has it."""
        if context is None or roi is None or context.header.seq != roi.header.seq:
            return
        if not roi.pixels.size:
            self._out.clear(f"window/{name}")
            return
        # of one size, as a viewer takes the pictures of one place for a video
        width, height = roi.size_px
        shrink = -(-width // MOST_WINDOW_PX)
        size_px = width // shrink, height // shrink
        shown = same_window(context, roi.window, size_px)
        contents = encoded(shown, self.settings.jpeg_quality)
        self._out.picture(f"window/{name}", contents, roi.window, size_px, 0)

    def _grow_trails(self, tracks: Tracks) -> None:
        self._trails = {
            int(i): self._trails.get(int(i), deque(maxlen=TRAIL_FRAMES)) for i in tracks.ids
        }
        for i, centre in zip(tracks.ids, centres(tracks.boxes[:, -1]), strict=True):
            self._trails[int(i)].append(centre)

    def _wanted(self, message: Message, source: str) -> bool:
        """Whether this frame is shown; if so, sets the time and tells how its stage did."""
        self._say(message.header, self._events.arrived(message.header))
        if message.header.seq % self.settings.every or not self._out.wanted():
            return False
        self._at(message.header, source)
        for stage, count in self._events.missing.items():
            self._out.value(["drops", stage, "missing"], count)
        if self.settings.details:
            for name, value in latencies(message.header).items():
                self._out.value(f"latency/each/{name}", value)
        return True

    def _say(self, header: Header, lines: Iterable[str]) -> None:
        """Add lines to the log, as many as fit."""
        for line in lines:
            more = self._events.allowed(header.seq)
            if more is None or not self._out.takes():
                continue
            self._at(header)
            self._out.line(f"{line} ({more} lines before it were left out)" if more else line)

    def _picture(self, path: str, frame: Frame, order: int) -> None:
        if not frame.pixels.size:
            self._out.clear(path)
            return
        contents = jpeg(frame, self.settings.jpeg_quality)
        self._out.picture(path, contents, frame.window, frame.size_px, order)
