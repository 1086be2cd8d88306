"""Follow one object through context and ROI: Frame, Frame (and a Scanpath) -> Percept.

The consumer of the paper's tracking task: a search-template tracker, ViTTrack in place of
MixFormerV2, or MixFormerV2 itself for those who have its weights.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from operators.tracker.correlation import Correlation
from operators.tracker.look import Picture, Streams
from operators.tracker.mixformer import MixFormer
from operators.tracker.vittrack import VitTrack
from pipeline import Frame, Header, Input, Operator, Percept, Scanpath, SettingsError
from pipeline.errors import WeightsError
from pipeline.inference import Network
from pipeline.weights import find

NOBODY = -1  # the id of an object that is no track


@dataclass(frozen=True, kw_only=True)
class TrackerSettings:
    """What a graph may set. auto: the network when its weights are there, else correlation."""

    method: Literal["auto", "vittrack", "mixformer", "correlation"] = "auto"
    weights: str = ""  # an ONNX file; empty: vitTracker.onnx as `fovea weights pull` left it
    init_box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # sensor px, first frame
    lost_score: float = -1.0  # below it the object counts as lost; negative: the method's own
    lost_after: int = 5  # lost frames in succession before the scanpath's object is taken instead
    threads: int = 1

    def __post_init__(self) -> None:
        left, top, right, bottom = self.init_box
        if any(self.init_box) and not (left < right and top < bottom):
            raise SettingsError(f"init_box: expected left, top, right, bottom, got {self.init_box}")
        for name in ("lost_after", "threads"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        if self.lost_score > 1:
            raise SettingsError(f"lost_score: must be at most 1, got {self.lost_score}")


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackerState:
    """What a successor needs: where the object is, and what it looked like at the start."""

    box: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    object_id: int = NOBODY
    lost_frames: int = 0
    template: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))


class Follower(Protocol):
    """A method of following: start on a box, then find it again and again."""

    patience_score: float

    def start(self, streams: Streams, box: NDArray[np.float32]) -> Picture: ...

    def resume(self, template: Picture) -> None: ...

    def follow(
        self, streams: Streams, box: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float]: ...


class Tracker(Operator[TrackerSettings, Percept]):
    """One box per frame, none before there is anything to follow; a lost object keeps its place.

    It starts on `init_box` in the first frame, else on the object that a scanpath chose.
    """

    context = Input(Frame, keep="latest")
    roi = Input(Frame, keep="latest")
    scanpath = Input(Scanpath, join=False)

    def open(self) -> None:
        """Load the network, if it is to be used; raises `WeightsError`."""
        s = self.settings
        self._follower = chosen(s.method, s.weights, s.threads)
        own = self._follower.patience_score
        self._lost_score = own if s.lost_score < 0 else s.lost_score
        self._scratch: dict[int, Picture] = {}
        self._scanpath: Scanpath | None = None
        self._forget()

    def on_stream(self, header: Header) -> None:
        """Another stream shows other objects."""
        self._forget()

    def state(self) -> TrackerState:
        """The object as of now."""
        return TrackerState(
            box=self._box,
            object_id=self._object_id,
            lost_frames=self._lost_frames,
            template=self._template,
        )

    def restore(self, state: TrackerState) -> None:
        """Follow what another instance followed."""
        self._box, self._object_id = state.box, state.object_id
        self._lost_frames, self._template = state.lost_frames, state.template
        self._fresh = False
        if len(self._box):
            self._follower.resume(self._template)

    def on_scanpath(self, scanpath: Scanpath) -> None:
        """Remember what the policy looks at, for the next start."""
        self._scanpath = scanpath

    def on_context_roi(self, context: Frame, roi: Frame) -> Percept:
        """Find the object in this exposure, or start on one."""
        streams = Streams(context=context, roi=roi, scratch=self._scratch)
        score = self._follow(streams) if len(self._box) else 0.0
        if not len(self._box) or self._lost_frames >= self.settings.lost_after:
            score = self._start(streams, context.header, score)
        self._fresh = False
        return Percept(
            header=context.header,
            boxes=self._box,
            ids=np.full(len(self._box), self._object_id, np.int32),
            scores=np.full(len(self._box), score, np.float32),
        )

    def _forget(self) -> None:
        self.restore(TrackerState())
        self._scanpath = None
        self._fresh = True  # no frame of this stream has been seen

    def _follow(self, streams: Streams) -> float:
        box, score = self._follower.follow(streams, self._box[0])
        lost = score < self._lost_score
        self._lost_frames = self._lost_frames + 1 if lost else 0
        if not lost:
            self._box = box[None]
        return score

    def _start(self, streams: Streams, header: Header, score: float) -> float:
        """Take the object asked for, if any; returns the score to tell."""
        box, object_id = np.array(self.settings.init_box, np.float32), NOBODY
        if not (self._fresh and box.any()):
            box, object_id = proposed(self._scanpath, header.seq)
        if not box.any():
            return score
        self._template = self._follower.start(streams, box)
        self._box, self._object_id, self._lost_frames = box[None], object_id, 0
        return 1.0


def proposed(scanpath: Scanpath | None, seq: int) -> tuple[NDArray[np.float32], int]:
    """Where the chosen object is foreseen in frame `seq`, and its id; zeros without an object."""
    row = seq - scanpath.first_seq if scanpath else -1
    if scanpath is None or not 0 <= row < len(scanpath.choice) or scanpath.choice[row] < 0:
        return np.zeros(4, np.float32), NOBODY
    return scanpath.boxes[row], int(scanpath.choice[row])


def chosen(method: str, weights: str, threads: int) -> Follower:
    """The method asked for; raises `WeightsError` when it needs weights that are not there."""
    if method == "correlation":
        return Correlation()
    if method == "mixformer" and not weights:
        raise WeightsError("tracker.weights: expected MixFormerV2 as an ONNX file, got nothing")
    path = Path(weights) if weights else find("vittrack")
    if path is None or not path.is_file():
        if method == "auto" and not weights:
            return Correlation()
        raise WeightsError(
            f"tracker.weights: expected an ONNX file, got {path or 'nothing'}; "
            "try `fovea weights pull vittrack`, or set method: correlation"
        )
    mixed = method == "mixformer" or (method == "auto" and "img_search" in Network(path).inputs)
    return MixFormer(path, threads=threads) if mixed else VitTrack(path, threads=threads)
