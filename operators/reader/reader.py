"""Read texts: context and ROI -> Percept with the texts in view, collected over frames.

The consumer of the paper's text task, frozen: PP-OCR finds and reads what is in the ROI, at the
ROI's own resolution. Every frame is answered with all texts that are known and in the field, not
only with those that this ROI shows.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from operators.reader.instances import Instance, Instances
from operators.reader.ocr import SAME_IOU, PaddleOcr, Reading, check_files
from pipeline import Frame, Header, Input, Operator, Percept, SettingsError, Tracks
from pipeline.boxes import iou
from pipeline.errors import MessageError
from pipeline.messages import Boxes, Ids, Shape
from pipeline.providers import check_threads

Reads = Literal["roi", "context", "both"]
READS = ("roi", "context", "both")


@dataclass(frozen=True, kw_only=True)
class ReaderSettings:
    """What a graph may set."""

    reads: Reads = "roi"  # which pictures; a sensor without ROI needs context
    least_score: float = 0.5  # of a reading; less sure ones are left out
    threads: int = 1
    forget_after: int = 60  # frames without a reading after which a text is forgotten
    detection: str = ""  # ONNX files of PP-OCR; empty: those that rapidocr brings
    recognition: str = ""

    def __post_init__(self) -> None:
        check_reader(self.reads, self.least_score, self.threads, self.forget_after)


def check_reader(reads: str, least_score: float, threads: int, forget_after: int) -> None:
    """Raise `SettingsError` for settings out of range."""
    if reads not in READS:
        raise SettingsError(f"reads: expected {', '.join(READS)}, got {reads!r}")
    if not 0 <= least_score <= 1:
        raise SettingsError(f"least_score: must be within 0..1, got {least_score}")
    check_threads(threads)
    if forget_after < 1:
        raise SettingsError(f"forget_after: must be at least 1, got {forget_after}")


@dataclass(frozen=True, kw_only=True, eq=False)
class ReaderState:
    """What was read, so that a swap loses nothing; rows of instances, and of their votes."""

    ids: Ids
    boxes: Boxes
    velocities: Annotated[NDArray[np.float32], Shape.of("n", 4)]
    seqs: Annotated[NDArray[np.int64], Shape.of("n")]
    voters: Annotated[NDArray[np.int32], Shape.of("votes")]  # id of the instance
    weights: Annotated[NDArray[np.float32], Shape.of("votes")]
    best: Annotated[NDArray[np.float32], Shape.of("votes")]
    texts: tuple[str, ...]  # votes
    next_id: int


S = TypeVar("S")


class TextReader(Operator[S, Percept]):
    """What readers share: one answer per exposure; ids of texts are the reader's own.

    Each reader's class says how a picture is read.
    """

    live: ClassVar[tuple[str, ...]] = ()
    context = Input(Frame, keep="latest")
    roi = Input(Frame, keep="latest")
    tracks = Input(Tracks, join=False, optional=True)

    reads: str = "roi"
    forget_after: int = 60

    def read(self, frame: Frame) -> list[Reading]:
        """Return the texts in a picture that has pixels, in its own pixels."""
        raise NotImplementedError

    def open(self) -> None:
        """Start without texts."""
        self._instances = Instances(self.forget_after)
        self._tracks: Tracks | None = None
        self._frames = self._readings = 0

    def on_stream(self, header: Header) -> None:
        """Another stream shows other texts."""
        self._instances = Instances(self.forget_after)
        self._tracks = None

    def on_tracks(self, tracks: Tracks) -> None:
        """Remember where texts are; only some readers need it."""
        self._tracks = tracks

    def on_context_roi(self, context: Frame, roi: Frame) -> Percept:
        """Read this exposure, and answer with all that is known."""
        frames = {"roi": [roi], "context": [context], "both": [roi, context]}[self.reads]
        readings: list[Reading] = []
        boxes: list[NDArray[np.float32]] = []
        for frame in frames:
            if frame.pixels.size:
                check_pixels(frame)
                found = [(reading, on_sensor(reading, frame)) for reading in self.read(frame)]
                # of what both show the ROI has more pixels
                new = [(r, box) for r, box in found if not _known(box, boxes)]
                readings += [reading for reading, _ in new]
                boxes += [box for _, box in new]
        seq, geometry = roi.header.seq, roi.header.geometry
        self._instances.hear(readings, np.array(boxes, np.float32).reshape(-1, 4), seq)
        self._frames, self._readings = self._frames + 1, self._readings + len(readings)
        known = self._instances.in_view(seq, (geometry.width_px, geometry.height_px))
        return Percept(
            header=roi.header,
            boxes=np.array([box for _, box in known], np.float32).reshape(-1, 4),
            ids=np.array([each.id for each, _ in known], np.int32),
            scores=np.array([each.score for each, _ in known], np.float32),
            texts=tuple(each.text for each, _ in known),
        )

    def summary(self) -> Mapping[str, Any]:
        """How much was read."""
        texts = self._instances.next_id - 1
        return {"frames": self._frames, "readings": self._readings, "texts": texts}

    def headline(self) -> str:
        """How many texts there were."""
        return f"{self._instances.next_id - 1} texts"

    def state(self) -> ReaderState:
        """Return what was read."""
        kept = self._instances.kept
        votes = [(each.id, text) for each in kept for text in each.votes]
        by_id = {each.id: each for each in kept}
        return ReaderState(
            ids=np.array([each.id for each in kept], np.int32),
            boxes=np.array([each.box for each in kept], np.float32).reshape(-1, 4),
            velocities=np.array([each.velocity for each in kept], np.float32).reshape(-1, 4),
            seqs=np.array([each.seq for each in kept], np.int64),
            voters=np.array([id_ for id_, _ in votes], np.int32),
            weights=np.array([by_id[i].votes[text] for i, text in votes], np.float32),
            best=np.array([by_id[i].best[text] for i, text in votes], np.float32),
            texts=tuple(text for _, text in votes),
            next_id=self._instances.next_id,
        )

    def restore(self, state: ReaderState) -> None:
        """Take over what another reader has read; texts without a vote are left out."""
        instances = Instances(self.forget_after)
        instances.next_id = state.next_id
        made = {
            int(id_): Instance(id=int(id_), box=box, velocity=velocity, seq=int(seq))
            for id_, box, velocity, seq in zip(
                state.ids, state.boxes, state.velocities, state.seqs, strict=True
            )
        }
        for id_, weight, best, text in zip(
            state.voters, state.weights, state.best, state.texts, strict=True
        ):
            if (each := made.get(int(id_))) is not None:
                each.votes[text], each.best[text] = float(weight), float(best)
        instances.kept = [each for each in made.values() if each.votes]
        self._instances = instances


class Reader(TextReader[ReaderSettings]):
    """Reads with PP-OCR, which finds the texts by itself."""

    @classmethod
    def advise(cls, settings: ReaderSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `WeightsError` for a network that is not there."""
        check_files(detection=settings.detection, recognition=settings.recognition)
        return ()

    def open(self) -> None:
        """Load the networks; raises `InstallError` and `WeightsError`."""
        s = self.settings
        self.reads, self.forget_after = s.reads, s.forget_after
        super().open()
        self._ocr = PaddleOcr(
            threads=s.threads, least_score=s.least_score, detection=s.detection,
            recognition=s.recognition,
        )  # fmt: skip

    def runs_on(self) -> str:
        """What computes the networks: rapidocr's choice, no setting of this node."""
        return self._ocr.provider

    def read(self, frame: Frame) -> list[Reading]:
        """Return the texts in a picture."""
        return self._ocr(np.asarray(frame.pixels, np.uint8))


def check_pixels(frame: Frame) -> None:
    """Raise `MessageError` for pixels that are not RGB of 8 bit."""
    if frame.pixels.ndim != 3 or frame.pixels.dtype != np.uint8:
        raise MessageError(
            f"expected pixels of 8 bit (h, w, 3), got {frame.pixel_format} "
            f"{frame.pixels.dtype} {list(frame.pixels.shape)}; a node of "
            "operators.downsample:Downsample makes them"
        )


def on_sensor(reading: Reading, frame: Frame) -> NDArray[np.float32]:
    """Return a reading's box (4,) in sensor pixels."""
    left, top, right, low = frame.window
    high, wide = frame.pixels.shape[:2]
    scale = np.array([(right - left) / wide, (low - top) / high] * 2)
    return np.asarray(np.array(reading.box) * scale + (left, top, left, top), np.float32)


def _known(box: NDArray[np.float32], boxes: list[NDArray[np.float32]]) -> bool:
    """Whether a box is that of a text which was read already."""
    return bool(boxes) and float(iou(box[None], np.array(boxes)).max()) > SAME_IOU
