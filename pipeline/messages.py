"""The messages that flow between operators (Eq. 2, 3 and 6 of the paper, and those around them).

Every box is `xyxy` float32 in sensor pixels (full resolution), whichever stream it comes from.
Messages are immutable; absent arrays are empty, never `None`. `Shape` states what the codec
checks: a number is a fixed side, a name is a side that every array of one message agrees on.
"""

from dataclasses import dataclass, field, fields
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.pixel_formats import PACKED, size_px

T = TypeVar("T")
LONGEST_FIELD = 60  # characters of one in the `repr` of a message


@dataclass(frozen=True)
class Shape:
    """The shape of an array, outermost side first; it may list alternatives."""

    sides: tuple[tuple[int | str, ...], ...]

    @staticmethod
    def of(*sides: int | str) -> "Shape":
        """Return a shape with one allowed form, e.g. `Shape.of("n", 4)`."""
        return Shape((sides,))

    def check(self, where: str, shape: tuple[int, ...], known: dict[str, int]) -> None:
        """Raise `MessageError` unless `shape` fits; named sides are stored in `known`."""
        for form in self.sides:
            if len(form) != len(shape):
                continue
            for want, got in zip(form, shape):  # noqa: B905 - equal by the line above
                if want.__class__ is str:
                    if known.setdefault(want, got) != got:
                        break
                elif want != got:
                    break
            else:
                return
        raise MessageError(f"{where}: expected shape {self}, got {shape}")

    def __str__(self) -> str:
        return " or ".join("(" + ", ".join(map(str, form)) + ")" for form in self.sides)


Boxes = Annotated[NDArray[np.float32], Shape.of("n", 4)]  # xyxy, sensor pixels
Ids = Annotated[NDArray[np.int32], Shape.of("n")]
Scores = Annotated[NDArray[np.float32], Shape.of("n")]
Pixels = Annotated[NDArray[np.uint8] | NDArray[np.uint16], Shape((("h", "w"), ("h", "w", 3)))]


@dataclass(frozen=True, kw_only=True)
class Span:
    """What one stage did with a message; times in nanoseconds of the header's clock."""

    stage: str
    received_ns: int
    done_ns: int
    handler_ns: int  # inside the operator's own code
    scheduling_delay_ns: int  # runnable but waiting for a core, since the previous stage


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Geometry of the sensor and its ROI, in sensor pixels, so that no stage hard-codes it."""

    width_px: int = 0
    height_px: int = 0
    roi_width_px: int = 0
    roi_height_px: int = 0
    step_px: int = 1  # windows start at multiples of this

    def aligned(self, value_px: int) -> int:
        """Return the largest multiple of `step_px` that is not above `value_px`."""
        return value_px - value_px % self.step_px


@dataclass(frozen=True, kw_only=True)
class Header:
    """The exposure of a message; every stage passes stream, seq and stamp unchanged."""

    stream: str  # new each time a sensor is opened
    seq: int  # index k of the exposure within the stream
    stamp_ns: int  # when the picture was ready, before its readout
    clock: str = "monotonic"  # this host's; between hosts, the label of the exposing host's clock
    geometry: Geometry = Geometry()
    epoch: int = 0  # instance of the node that sent this; set by the runtime
    trace: tuple[Span, ...] = ()  # stages passed so far; set by the runtime


@dataclass(frozen=True, kw_only=True, eq=False)
class Message:
    """Base class of all messages.

    Its `repr`, which your own messages inherit, is short: an array is its dtype and shape.

    >>> header = Header(stream="s", seq=7, stamp_ns=0)
    >>> Frame(header=header, pixels=np.zeros((2, 4, 3), np.uint8), window=(0, 0, 8, 4))
    Frame(seq=7, pixels=uint8[2, 4, 3], pixel_format='rgb8', window=(0, 0, 8, 4), command_seq=-1, \
status='ok', delay_ns=0)
    """

    header: Header

    def __init_subclass__(cls) -> None:
        if "__repr__" not in vars(cls):  # a dataclass would make one that prints whole arrays
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        rest = [f.name for f in fields(self) if f.name != "header"]
        parts = [f"{name}={_brief(getattr(self, name))}" for name in rest]
        seq = getattr(self.header, "seq", "?")  # works for invalid messages, too
        return f"{type(self).__qualname__}({', '.join([f'seq={seq}', *parts])})"


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame(Message):
    """Pixels of one exposure: (h, w) for a Bayer mosaic or grey, (h, w, 3) for RGB.

    Packed raw pictures travel as the sensor sent them, (h, row_bytes) uint8; `size_px` is the size
    of the picture in any case. A Bayer format names the order from the picture's first pixel on.
    `window` is the region of the sensor that they show (xyxy), so scale = window / size. A sensor
    that reads no ROI in this exposure sends an empty picture (0, 0, 3) with an empty window.
    """

    pixels: Pixels
    pixel_format: str = "rgb8"  # a name of pipeline.pixel_formats: rgb8 | grey8 | bayer_rggb12p …
    window: tuple[int, int, int, int] = (0, 0, 0, 0)  # sensor pixels
    command_seq: int = -1  # seq of the RoiSchedule that set the window, -1: none
    status: str = "ok"  # ok | unplanned (no command covered it) | stale (it came too late)
    delay_ns: int = 0  # exposed this long after the header's stamp; 0: in the same exposure

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture, which a packed one does not have as its shape."""
        return size_px(self.pixel_format, self.pixels.shape)

    @property
    def packed(self) -> bool:
        """Whether `pixels` holds rows of packed bytes instead of one number per sample."""
        return self.pixel_format in PACKED


@dataclass(frozen=True, kw_only=True, eq=False)
class Detections(Message):
    """Objects detected in one context frame (Eq. 2); n may be 0."""

    boxes: Boxes
    angles: Scores  # radians, 0 for upright boxes
    scores: Scores  # 0..1
    labels: Ids  # index into names
    features: Annotated[NDArray[np.float32], Shape.of("n", "channels")]  # stride-8 map, RoIAlign
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks(Message):
    """Objects tracked over the last To frames and predicted for the next Tp (Eq. 3).

    Column To-1 is this frame, column 0 of `predicted` the next one. The filter fills gaps;
    `visible` marks the columns with a detection.
    """

    ids: Ids
    labels: Ids
    scores: Scores
    boxes: Annotated[NDArray[np.float32], Shape.of("n", "observed", 4)]
    visible: Annotated[NDArray[np.bool_], Shape.of("n", "observed")]
    features: Annotated[NDArray[np.float32], Shape.of("n", "observed", "channels")]
    predicted: Annotated[NDArray[np.float32], Shape.of("n", "horizon", 4)]
    names: tuple[str, ...] = ()

    def name_of(self, row: int) -> str:
        """Return the class name of a track; empty when it has none."""
        label = int(self.labels[row])
        return self.names[label] if 0 <= label < len(self.names) else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class RoiFeatures(Message):
    """High-resolution appearance of the tracks inside this frame's ROI.

    `genuine` is the encoder's confidence, from these pixels, that an object is of its labelled
    class; 1 where the encoder does not estimate it.
    """

    ids: Ids
    features: Annotated[NDArray[np.float32], Shape.of("n", "channels")]
    genuine: Scores


@dataclass(frozen=True, kw_only=True, eq=False)
class Scanpath(Message):
    """The object to look at in each of the next Tp frames (Eq. 6); Tp = 0: no proposal."""

    ids: Ids
    probability: Annotated[NDArray[np.float32], Shape.of("horizon", "n")]
    choice: Annotated[NDArray[np.int32], Shape.of("horizon")]  # track id, -1: a position only
    boxes: Annotated[NDArray[np.float32], Shape.of("horizon", 4)]  # where it will be
    first_seq: int  # the frame of row 0


@dataclass(frozen=True, kw_only=True, eq=False)
class RoiSchedule(Message):
    """The sensor command: one window per frame from `first_seq` on; T = 0: no change.

    A sensor that reads several windows in one exposure takes (frames, windows, 4); a row without
    area is a window that is not read.
    """

    first_seq: int
    windows: Annotated[
        NDArray[np.int32], Shape((("frames", 4), ("frames", "windows", 4)))
    ]  # xyxy, sensor pixels
    scanpath_seq: int = -1  # seq of the scanpath behind it


@dataclass(frozen=True, kw_only=True, eq=False)
class Percept(Message):
    """A consumer's result from context and ROI: boxes with ids, texts, or an action.

    Without boxes, there is no target or it is lost.
    """

    boxes: Boxes
    ids: Ids
    scores: Scores
    texts: tuple[str, ...] = ()
    action: Annotated[NDArray[np.float32], Shape.of("actions")] = field(
        default_factory=lambda: np.zeros(0, np.float32)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth(Message):
    """Ground truth of a picture, from a source that knows it; for scoring."""

    boxes: Boxes
    ids: Ids  # constant per object over the whole stream
    labels: tuple[str, ...]  # n, as the source calls them: ball, player, main referee, …
    visibility: Scores  # visible fraction of each object, 0..1


def _brief(value: Any) -> str:
    """Return a field as `Message.__repr__` shows it, on one line."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    text = repr(value)
    return text if len(text) <= LONGEST_FIELD else f"{text[:LONGEST_FIELD]}…"


def stamped(header: Header, *, epoch: int, span: Span) -> Header:
    """Return the header that leaves a stage: the same exposure with one more span."""
    return altered(header, epoch=epoch, trace=(*header.trace, span))


def altered(value: T, **changes: Any) -> T:
    """Copy a frozen dataclass with changes, as `replace` does, but without its checks.

    It is fast enough for every message of every stage.
    """
    fresh = object.__new__(type(value))
    fresh.__dict__.update(value.__dict__, **changes)
    return fresh
