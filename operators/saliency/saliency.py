"""Find candidate objects in the context picture: Frame -> Detections (Eq. 2).

Runs the shipped detector, or any YOLO detect, YOLO OBB or YOLOX export in ONNX (detector.py).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.saliency.advice import advice
from operators.saliency.decode import Candidates
from operators.saliency.description import Format, check_size, side_file
from operators.saliency.detector import FEATURE_STRIDE_PX, SHIPPED, Detector
from operators.saliency.difference import FrameDifference
from operators.saliency.letterbox import Placement
from operators.saliency.roi_align import roi_align
from pipeline import Detections, Frame, Header, Input, MessageError, Operator, SettingsError
from pipeline.contract import SOURCE
from pipeline.providers import NetworkSettings

__all__ = ["SHIPPED", "Detector", "Saliency", "SaliencySettings"]


@dataclass(frozen=True, kw_only=True)
class SaliencySettings(NetworkSettings):
    """What a graph may set."""

    # an ONNX file, or a name that `fovea weights` knows; empty: the shipped one; eight_bits: the
    # shipped one quantised; corners: eight_bits with a head for the ball that knows corner flags;
    # larger: one trained for 736x416 and 480x288, quantised; crowds: the same for people before one
    # another; moving: crowds trained on for a ball at corner flags, and one that moves; roi: one
    # for what a ROI shows, balls in hands among it, quantised; objects: that of what a robot
    # handles; text: that of texts in streets
    weights: str = ""
    format: Format = "auto"  # of the network's output
    input_px: tuple[int, int] = (0, 0)  # width, height where the network leaves them open
    names: Mapping[str, str] = field(default_factory=dict)  # network's class or its number -> name
    confidence: float = 0.0  # for all classes; 0: the network's own, 0.25 where it has none
    class_confidence: Mapping[str, float] = field(default_factory=dict)  # by reported name
    nms_iou: float = 0.5
    class_agnostic: bool = True  # one place holds one object, whatever its class
    max_objects: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        shares = {"confidence": self.confidence, "nms_iou": self.nms_iou}
        shares |= {f"class_confidence.{k}": v for k, v in self.class_confidence.items()}
        for name, share in shares.items():
            if not 0 <= share <= 1:
                raise SettingsError(f"{name}: must be within 0..1, got {share}")
        if self.max_objects < 1:
            raise SettingsError(f"max_objects: must be at least 1, got {self.max_objects}")
        if any(self.input_px):
            try:
                check_size(self.input_px)
            except ValueError as error:
                raise SettingsError(f"input_px: {error}") from error

    @cached_property
    def detector(self) -> Detector:
        """The detector of these settings; raises `WeightsError`, `SettingsError`."""
        return Detector(self)

    @property
    def reported_classes(self) -> tuple[str, ...]:
        """The classes that the detector reports; raises as `detector` does."""
        return self.detector.names

    @property
    def feature_channels(self) -> int:
        """Length of an object's features, 0 without a feature map; raises as `detector` does."""
        return self.detector.channels


class Saliency(Operator[SaliencySettings, Detections]):
    """One answer per frame, boxes in sensor pixels; nothing found is an empty message."""

    frame = Input(Frame, keep="latest")

    @classmethod
    def advise(cls, settings: SaliencySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """What the detector knows; warnings of another kind of source and of classes without names.

        Raises `WeightsError` for weights that are not there, or are none of a detector.
        """
        detector = settings.detector
        lines = list(advice(detector.names, detector.known, upstream.get(SOURCE)))
        if not detector.known.names and not settings.names:
            file, side = detector.path.name, side_file(detector.path).name
            what = f"warning: nothing names the classes of {file}: they are called by their numbers"
            lines.append(f"{what}; a list `names` in {side} beside it names them")
        return lines

    def open(self) -> None:
        self._detector = Detector(self.settings)
        self._before = FrameDifference()
        self._window: tuple[int, ...] = ()

    def on_stream(self, header: Header) -> None:
        """Forget the last picture: another stream shows something else."""
        self._before.forget()

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on, and how much of its output was unusable."""
        return self._detector.summary()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._detector.network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._detector.network.provider

    def state(self) -> None:
        """Nothing must survive: a successor lacks what changed since one picture."""

    def on_frame(self, frame: Frame) -> Detections:
        detector = self._detector
        if not frame.pixels.size:
            return answer(frame, nothing(), np.zeros((0, 0), np.float32), detector)
        picture = rgb(frame)
        found, placement, features = detector.look(picture, self._difference(frame, picture))
        appearance = np.zeros((len(found.scores), 0), np.float32)
        if features is not None:
            appearance = roi_align(features, found.boxes, stride_px=FEATURE_STRIDE_PX)
        return answer(frame, to_sensor(found, placement, frame), appearance, detector)

    def _difference(self, frame: Frame, picture: NDArray[np.uint8]) -> NDArray[np.int16] | None:
        """What changed since the last picture of the same window, for a network that reads it.

        That is the last one that came: where frames are dropped, more has moved since.
        """
        if not self._detector.reads_difference:
            return None
        if frame.window != self._window:  # a region of interest somewhere else
            self._before.forget()
            self._window = frame.window
        return self._before.of(picture)


def to_sensor(found: Candidates, placement: Placement, frame: Frame) -> Candidates:
    """Candidates in input pixels -> in sensor pixels, upright ones cut to the frame's window."""
    height_px, width_px = frame.pixels.shape[:2]
    left, top, right, bottom = frame.window
    scale = np.array([(right - left) / width_px, (bottom - top) / height_px] * 2, np.float32)
    offset = np.array([placement.left_px, placement.top_px] * 2, np.float32)
    boxes = (found.boxes - offset) / np.float32(placement.gain) * scale
    boxes += np.array([left, top] * 2, np.float32)
    upright = found.angles == 0
    window = np.array(frame.window, np.float32)
    inside = np.clip(boxes, window[[0, 1, 0, 1]], window[[2, 3, 2, 3]])
    boxes = np.where(upright[:, None], inside, boxes)
    return Candidates(boxes=boxes, angles=found.angles, scores=found.scores, classes=found.classes)


def answer(
    frame: Frame, found: Candidates, features: NDArray[np.float32], detector: Detector
) -> Detections:
    """The message about a frame, of objects in sensor pixels and their features (n, C)."""
    return Detections(
        header=frame.header,
        boxes=found.boxes,
        angles=found.angles,
        scores=found.scores,
        labels=found.classes.astype(np.int32),
        features=features,
        names=detector.names,
    )


def nothing() -> Candidates:
    """No objects."""
    none = np.zeros(0, np.float32)
    return Candidates(
        boxes=np.zeros((0, 4), np.float32), angles=none, scores=none, classes=none.astype(np.intp)
    )


def rgb(frame: Frame) -> NDArray[np.uint8]:
    """The pixels of a frame; raises `MessageError` for those that are no RGB or grey picture."""
    if frame.pixel_format not in ("rgb8", "grey8") or frame.pixels.dtype != np.uint8:
        raise MessageError(
            f"saliency.frame: expected rgb8 or grey8 pixels, got {frame.pixel_format} "
            f"{frame.pixels.dtype}; put operators.downsample before it"
        )
    return np.asarray(frame.pixels, np.uint8)
