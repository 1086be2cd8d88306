"""The operators of a graph without its runner: in one process, with random access to frames.

What the loop computes from the context does not depend on where the ROI is. It is computed once for
a clip, and every episode adds only policy, encoder and tracker. A test compares the result with the
in-line runner on the shipped graph.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.tracking.budgets import TOLERANCE, Acquisition
from bench.tracking.classes import planned
from bench.tracking.clip import Clip
from bench.tracking.replaced import Replaced
from drivers.commands import Window
from drivers.simulated.readout import Readout
from pipeline import settings as checked
from pipeline.contract import Operator, settings_of
from pipeline.errors import GraphError, RunError
from pipeline.executor import Executor, carried
from pipeline.graph.plan import load_operator
from pipeline.messages import Frame, Header, Message, Tracks

NEEDED = ("downsample", "saliency", "association", "roi_features", "policy", "dispatch", "tracker")
EMPTY: Window = (0, 0, 0, 0)


class Stages:
    """The opened operators of a tracking graph, by node name; use it as a context manager."""

    def __init__(
        self, graph: Path, changes: Sequence[str] = (), tracker: str = "", policy: str = ""
    ) -> None:
        self.plan = planned(graph, changes, tracker, policy)
        known = {node.name for node in self.plan.nodes}
        for name in NEEDED:
            if name not in known:
                raise GraphError(
                    f"{graph}: tracking is evaluated on {', '.join(NEEDED)}; no {name}"
                )
        self._parts: dict[str, Operator[Any, Any]] = {}
        self._executors: dict[str, Executor] = {}
        for name in NEEDED:
            node = self.plan.node(name)
            cls = load_operator(node.operator)
            self._parts[name] = cls(checked.build(settings_of(cls), node.settings, name))
            self._executors[name] = Executor(name, self._parts[name])

    def settings(self, name: str) -> Any:
        """Return the settings of a stage, defaults included."""
        return self._parts[name].settings

    def __enter__(self) -> "Stages":
        try:
            for part in self._parts.values():
                part.open()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for part in self._parts.values():
            part.close()

    def begin(self, header: Header, *names: str, **settings: Mapping[str, Any]) -> None:
        """Begin a new stream for some stages, with these settings changed by stage."""
        for name in names:
            part = self._parts[name]
            part.on_settings(replace(part.settings, **settings.get(name, {})))
            part.on_stream(header)

    def call(self, name: str, **messages: Message) -> Any:
        """Pass one set of messages to a stage; return its answer, None for nothing.

        As in a graph, the stage cannot write into them, and a wrong answer raises `RunError` or
        `MessageError`.
        """
        given = {key: carried(message, f"{name}.{key}") for key, message in messages.items()}
        answer = self._executors[name].call(given).get("out")
        return None if answer is None else carried(answer, f"{name}.out")


class Camera:
    """The simulated sensor's reading of a clip, exposure by exposure, with given ROI windows."""

    def __init__(self, clip: Clip, how: Acquisition) -> None:
        self._clip, self.how = clip, how
        width, height = clip.size_px
        self._readout = Readout(seed=0, most_px=width * height)
        self._whole = (0, 0, width, height)
        self._contexts: dict[int, Frame] = {}
        self._roi = np.empty(self._readout.shape(how.sampling.roi_px), np.uint8)
        self.begin()

    def begin(self) -> None:
        """Reset the counts."""
        self.emitted_px = self.exposures = 0

    def expose(self, frame: int, first: int, window: Window) -> tuple[Frame, Frame]:
        """Return context and ROI of one exposure, and count their pixels."""
        context, roi = self.context(frame, first), self.roi(frame, window)
        self.exposures += 1
        self.emitted_px += sum(math.prod(part.size_px) for part in (context, roi))
        return context, roi

    def counted(self) -> tuple[int, int]:
        """Return the pixels read since `begin`, and those of full resolution in the same time.

        An exposure counts for all frames until the next one, also if the clip ends before it.
        Raises `RunError` if the ratio is not the budget.
        """
        frames = self.exposures * self.how.sampling.interval
        full_px = frames * math.prod(self._clip.size_px)
        if self.exposures and not self.how.met_by(self.emitted_px / full_px):
            raise RunError(
                f"{self._clip.name}: {self.how.strategy} read {self.emitted_px / full_px:.5f} of "
                f"the pixels, expected {float(self.how.budget):.5f} within {TOLERANCE:.0%}"
            )
        return self.emitted_px, full_px

    def header(self, frame: int) -> Header:
        """Return the header of a frame of the clip."""
        stream = f"{self._clip.name}"
        return Header(stream=stream, seq=frame, stamp_ns=0, geometry=self.how.geometry)

    def context(self, frame: int, first: int = 0) -> Frame:
        """Return the whole field at `frame`; with averaging the mean of `first` … `frame`.

        Pictures of the full size are views of the clip's.
        """
        header = self.header(frame)
        if self.how.sampling.averaged:
            mean = np.mean(self._clip.pictures[first : frame + 1], axis=0, dtype=np.float32)
            pixels = np.rint(mean).astype(np.uint8)
            return Frame(header=header, pixels=pixels, window=self._whole)
        if self.how.sampling.context_px == self._clip.size_px:
            return Frame(header=header, pixels=self._clip.pictures[frame], window=self._whole)
        known = self._contexts.get(frame)
        if known is None:
            out = np.empty(self._readout.shape(self.how.sampling.context_px), np.uint8)
            self._readout.read(self._clip.pictures[frame], self._whole, out, seq=frame, port=0)
            known = Frame(header=header, pixels=out, window=self._whole)
            self._contexts[frame] = known
        return known

    def nothing(self, frame: int) -> Frame:
        """Return a picture without pixels."""
        pixels = np.empty((0, 0, 3), np.uint8)
        return Frame(header=self.header(frame), pixels=pixels, window=EMPTY)

    def roi(self, frame: int, window: Window) -> Frame:
        """Return the ROI at `frame`, valid until the next one; empty for strategies without.

        Raises `RunError` for a window of another size: it would cost more pixels than are counted.
        """
        if not self.how.looks:
            return self.nothing(frame)
        left, top, right, bottom = window
        if (right - left, bottom - top) != self.how.sampling.roi_px:
            raise RunError(
                f"frame {frame}: expected a window of {self.how.sampling.roi_px}, got {window}"
            )
        self._readout.read(self._clip.pictures[frame], window, self._roi, seq=frame, port=1)
        return Frame(header=self.header(frame), pixels=self._roi, window=window)


def watched(camera: Camera, stages: Stages, frames: int, replaced: Replaced) -> list[Tracks]:
    """Return the tracks that saliency and association find in the contexts of a clip's frames."""
    stages.begin(camera.header(0), "downsample", "saliency", "association")
    found = []
    for frame in range(frames):
        small = stages.call("downsample", frame=camera.context(frame))
        detections = replaced.detections(stages.call("saliency", frame=small), frame)
        found.append(stages.call("association", detections=detections))
    return found
