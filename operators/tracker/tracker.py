"""Follow one object through context and ROI: Frame, Frame (and a Scanpath) -> Percept.

The consumer of the paper's tracking task. It follows the policy's object: it starts on the object
that a scanpath chose, and changes when the policy chooses another object or has been beside this
one for some frames. An empty `Percept` means that the object is lost, or that there is none yet.
The commands `follow` and `reset` override the policy.

A sensor that reads several windows in one exposure sends the others as `roi_2` to `roi_4`. A look
takes its pixels from all of them. The one that shows most of the object, or of the policy's object
where none is followed, takes the place of the ROI in the rules.

Where a detector in the ROI is connected (`finds`), an object that is lost is answered where that
keeps finding it.

There is one class per method: `CorrelationTracker`, `VitTracker`, `MixFormerTracker`.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.tracker.finds import FAR_PX
from operators.tracker.following import Following, Method, Rules, TrackerState, proposed
from operators.tracker.look import Picture, Streams
from pipeline import (
    Detections,
    Frame,
    Header,
    Input,
    Operator,
    Percept,
    Scanpath,
    SettingsError,
)
from pipeline.boxes import covered

FURTHER_WAIT_MS = 50.0  # realtime: for further windows of an exposure, where they are connected
KEPT_PLANS = 8  # more than come while a set waits
COUNTS = ("lost_after", "drift_after", "switch_after", "hidden_after")


@dataclass(frozen=True, kw_only=True)
class TrackerSettings:
    """What a graph may set of every tracker; counts are frames in succession."""

    FORMER: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("cue_margin", "cue_after"), "removed; a second look gained nothing"
    )

    init_box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor px, first frame
    lost_score: float = -1.0  # below it the object was not found; negative: the method's own
    lost_after: int = 5  # frames without finding it, before it counts as lost
    drift_after: int = 6  # frames beside the object that the policy shows
    switch_after: int = 2  # the same, where the policy has chosen another object
    hidden_after: int = 8  # frames outside the ROI while the policy looks at a place
    # the same, whatever the ROI shows, for a policy that does so only where it has lost the object;
    # 0: never. With no more than `hidden_after` that rule has nothing left to do
    place_after: int = 0
    found_for: int = 150  # after its loss, in which an object is answered where `finds` have it

    def __post_init__(self) -> None:
        if any(self.init_box):
            check_box("init_box", self.init_box)
        for name in COUNTS:
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        for name in ("place_after", "found_for"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must not be negative, got {getattr(self, name)}")
        if not self.lost_score <= 1:
            raise SettingsError(f"lost_score: must be at most 1, got {self.lost_score}")


S = TypeVar("S", bound=TrackerSettings)


class Tracker(Operator[S, Percept]):
    """One box per frame, or none: nothing to follow yet, or lost.

    The box given by `init_box` or `follow` is kept until it is lost, or until `reset`; after that,
    and without it, the policy's object is followed. An object that is not found keeps its place
    for less than `lost_after` frames; one that the policy has lost is dropped (`place_after`). Each
    method's class says what `method` is.
    """

    live: ClassVar[tuple[str, ...]] = ("lost_score", *COUNTS, "place_after", "found_for")
    commands: ClassVar[tuple[str, ...]] = ("follow", "reset")
    context = Input(Frame, keep="latest")
    roi = Input(Frame, keep="latest")
    roi_2 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)
    roi_3 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)
    roi_4 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)
    finds = Input(Detections, join=False, optional=True)
    scanpath = Input(Scanpath, join=False)

    def method(self) -> Method:
        """The method, ready to be used; raises `WeightsError`."""
        raise NotImplementedError

    def open(self) -> None:
        """Load what the method needs; raises `WeightsError`."""
        method = self.method()
        self._usual_score, self._provider = method.patience_score, method.provider
        self._following = Following(method, self._rules())
        self._scratch: dict[int, Picture] = {}
        self._frames = self._answered = self._found = 0
        self._begin()

    def on_settings(self, settings: S) -> None:
        """Other thresholds from the next frame on."""
        self.settings = settings
        self._following.rules = self._rules()

    def on_stream(self, header: Header) -> None:
        """Another stream shows other objects."""
        self._begin()

    def do_follow(self, box: tuple[float, float, float, float]) -> dict[str, list[float]]:
        """Follow what is in this box (sensor pixels) in the next frame, whatever is looked at."""
        check_box("follow.box", box)
        self._following.take(np.array(box, np.float32))
        return {"following": list(box)}

    def do_reset(self) -> dict[str, int]:
        """Forget the object, a given one too; start again on what the policy shows."""
        forgotten = len(self._following.box)
        self._following.forget()
        return {"forgotten": forgotten}

    def state(self) -> TrackerState:
        """The object as of now, and what the method knows of it."""
        return self._following.state()

    def restore(self, state: TrackerState) -> None:
        """Follow what another instance followed."""
        self._following.restore(state)

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Remember what the policy shows; a set that waits is older than the newest plan."""
        self._scanpaths.append(scanpath)

    def on_finds(self, finds: Detections) -> None:
        """Note what a detector finds in the ROI, by which a lost object is found again."""
        self._following.see(finds)

    def on_context_roi(self, context: Frame, roi: Frame) -> Percept:
        """Find the object in this exposure, or start on one."""
        return self._find(context, [roi])

    def on_context_roi_roi_2(self, context: Frame, roi: Frame, roi_2: Frame | None) -> Percept:
        """Likewise, with a second window."""
        return self._find(context, [roi, roi_2])

    def on_context_roi_roi_2_roi_3(
        self, context: Frame, roi: Frame, roi_2: Frame | None, roi_3: Frame | None
    ) -> Percept:
        """Likewise, with three windows."""
        return self._find(context, [roi, roi_2, roi_3])

    def on_context_roi_roi_2_roi_3_roi_4(
        self,
        context: Frame,
        roi: Frame,
        roi_2: Frame | None,
        roi_3: Frame | None,
        roi_4: Frame | None,
    ) -> Percept:
        """Likewise, with four windows."""
        return self._find(context, [roi, roi_2, roi_3, roi_4])

    def _find(self, context: Frame, frames: Sequence[Frame | None]) -> Percept:
        following, seq = self._following, context.header.seq
        plan = next((plan for plan in reversed(self._scanpaths) if plan.first_seq <= seq), None)
        shown = proposed(plan, seq)
        box = following.box[0] if len(following.box) else shown.box if shown else None
        roi, *further = ordered([frame for frame in frames if frame is not None], box)
        streams = Streams(context=context, roi=roi, further=tuple(further), scratch=self._scratch)
        score = following.step(streams, shown)
        count = len(following.answer)
        self._frames, self._answered = self._frames + 1, self._answered + count
        self._found += count - len(following.box)
        return Percept(
            header=context.header,
            boxes=following.answer,
            ids=np.full(count, following.object_id, np.int32),
            scores=np.full(count, score, np.float32),
        )

    def headline(self) -> str:
        """Whether it has lost what it followed."""
        return "tracker: lost" if self._answered and not len(self._following.answer) else ""

    def runs_on(self) -> str:
        """The provider of the method's network; empty where it has none."""
        return self._provider

    def summary(self) -> Mapping[str, Any]:
        """In how many frames it answered, in how many of these it found a lost object again by
        `finds`, and how often it let go of one, and why.
        """
        counts = {"frames": self._frames, "answered": self._answered, "found": self._found}
        return {"tracker": {**counts, "let_go": dict(self._following.lost)}}

    def _rules(self) -> Rules:
        s = self.settings
        return Rules(
            lost_score=self._usual_score if s.lost_score < 0 else s.lost_score,
            lost_after=s.lost_after,
            drift_after=s.drift_after,
            switch_after=s.switch_after,
            hidden_after=s.hidden_after,
            place_after=s.place_after,
            found_for=s.found_for,
        )

    def _begin(self) -> None:
        """Before the first frame of a stream."""
        self._scanpaths = deque[Scanpath](maxlen=KEPT_PLANS)
        self._following.forget()
        if any(self.settings.init_box):
            self._following.take(np.array(self.settings.init_box, np.float32))


def ordered(frames: Sequence[Frame], box: NDArray[np.float32] | None) -> list[Frame]:
    """Return the windows of one exposure, first the one that shows most of a box (4,)."""
    if len(frames) == 1 or box is None:
        return list(frames)
    shares = [
        float(covered(box[None], np.array(f.window, np.float32))[0]) * (f.pixels.size > 0)
        for f in frames
    ]
    best = int(np.argmax(shares))
    return [frames[best], *frames[:best], *frames[best + 1 :]]


def check_box(name: str, box: tuple[float, float, float, float]) -> None:
    """Raise `SettingsError` unless these are left, top, right and bottom of a box."""
    left, top, right, bottom = box
    if not (max(map(abs, box)) < FAR_PX and left < right and top < bottom):
        raise SettingsError(f"{name}: expected left, top, right, bottom, got {box}")
