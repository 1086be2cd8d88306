"""Find candidate objects in the context picture: Frame -> Detections (Eq. 2).

Runs the shipped detector, or any YOLO detect, YOLO OBB or YOLOX export in ONNX.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from operators.saliency.advice import advice
from operators.saliency.classes import (
    class_names,
    named_classes,
    own_confidence,
    report_as,
    thresholds,
)
from operators.saliency.decode import (
    Candidates,
    Grid,
    Kind,
    class_count,
    decode_yolo,
    decode_yolox,
    kind_of,
    suppress,
    yolox_grid,
)
from operators.saliency.letterbox import Letterbox, Placement
from operators.saliency.roi_align import roi_align
from pipeline import Detections, Frame, Input, MessageError, Operator, SettingsError, WeightsError
from pipeline.contract import SOURCE
from pipeline.inference import Network
from pipeline.weights import weights_file

SHIPPED = Path(__file__).with_name("detector.onnx")
FEATURE_STRIDE_PX = 8


@dataclass(frozen=True, kw_only=True)
class SaliencySettings:
    """What a graph may set."""

    weights: str = ""  # an ONNX file, or a name that `fovea weights` knows; empty: the shipped one
    format: Literal["auto", "yolo", "obb", "yolox"] = "auto"  # of the network's output
    input_px: tuple[int, int] = (0, 0)  # width, height where the network leaves them open
    names: Mapping[str, str] = field(default_factory=dict)  # network's class or its number -> name
    confidence: float = 0.0  # for all classes; 0: the network's own, 0.25 where it has none
    class_confidence: Mapping[str, float] = field(default_factory=dict)  # by reported name
    nms_iou: float = 0.5
    class_agnostic: bool = True  # one place holds one object, whatever its class
    max_objects: int = 100
    threads: int = 1

    def __post_init__(self) -> None:
        shares = {"confidence": self.confidence, "nms_iou": self.nms_iou}
        shares |= {f"class_confidence.{k}": v for k, v in self.class_confidence.items()}
        for name, share in shares.items():
            if not 0 <= share <= 1:
                raise SettingsError(f"{name}: must be within 0..1, got {share}")
        for name, count in {"max_objects": self.max_objects, "threads": self.threads}.items():
            if count < 1:
                raise SettingsError(f"{name}: must be at least 1, got {count}")
        if min(self.input_px) < 0:
            raise SettingsError(f"input_px: must not be negative, got {self.input_px}")


class Saliency(Operator[SaliencySettings, Detections]):
    """One answer per frame, boxes in sensor pixels; nothing found is an empty message."""

    frame = Input(Frame, keep="latest")

    @classmethod
    def advise(cls, settings: SaliencySettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """What the detector knows, and a warning where the source shows something else.

        Raises `WeightsError` for weights that are not there.
        """
        metadata = Network(weights_file(settings.weights, SHIPPED)).metadata
        own = named_classes(metadata)
        names = report_as(own, settings.names)[0] if own else tuple(settings.names.values())
        return advice(names, metadata, upstream.get(SOURCE))

    def open(self) -> None:
        self._detector = Detector(self.settings)

    def state(self) -> None:
        """Nothing must survive: what changes is room for a picture."""

    def on_frame(self, frame: Frame) -> Detections:
        detector = self._detector
        if not frame.pixels.size:
            return _answer(frame, _nothing(), np.zeros((0, 0), np.float32), detector)
        found, placement, features = detector.look(_rgb(frame))
        appearance = np.zeros((len(found.scores), 0), np.float32)
        if features is not None:
            appearance = roi_align(features, found.boxes, stride_px=FEATURE_STRIDE_PX)
        return _answer(frame, to_sensor(found, placement, frame), appearance, detector)


class Detector:
    """A network together with what its metadata and the settings say about it."""

    def __init__(self, settings: SaliencySettings) -> None:
        self.settings = settings
        self.path = weights_file(settings.weights, SHIPPED)
        self.network = Network(self.path, threads=settings.threads)
        self.input, size_px = _input_of(self.network, self.path, settings)
        self.metadata = self.network.metadata
        # one run on an empty picture tells the shapes of exports with open sides
        blank = np.zeros((1, 3, size_px[1], size_px[0]), np.float32)
        shapes = {name: a.shape for name, a in self.network({self.input: blank}).items()}
        self.output = next(iter(shapes))
        shape = shapes[self.output]
        self.kind: Kind = (
            kind_of(shape, *size_px, self.metadata.get("task", ""))
            if settings.format == "auto"
            else settings.format
        )
        count = class_count(shape, self.kind)
        self.features = next((n for n, s in shapes.items() if _is_map(s, size_px)), None)
        self.names, self._reported = report_as(class_names(self.metadata, count), settings.names)
        own = {} if settings.confidence else own_confidence(self.metadata)
        limits = thresholds(self.names, own, settings.class_confidence, settings.confidence or 0.25)
        self._thresholds = limits[self._reported]  # -1, not reported, takes the last
        self._grid: Grid | None = yolox_grid(*size_px) if self.kind == "yolox" else None
        raw = self.kind == "yolox"
        self._box = Letterbox(*size_px, scale=1 if raw else 1 / 255, bgr=raw, corner=raw)

    def look(
        self, picture: NDArray[np.uint8]
    ) -> tuple[Candidates, Placement, NDArray[np.float32] | None]:
        """Objects in input pixels with reported classes, the placement and the feature map."""
        placement = self._box.put(picture)
        outputs = self.network({self.input: self._box.tensor})
        output = outputs[self.output][0]
        if self._grid is not None:
            found = decode_yolox(output, self._thresholds, self._grid)
        else:
            found = decode_yolo(output, self._thresholds, turned=self.kind == "obb")
        kept = suppress(found, self.settings.nms_iou, agnostic=self.settings.class_agnostic)
        found = found.take(kept[: self.settings.max_objects])
        named = Candidates(
            boxes=found.boxes,
            angles=found.angles,
            scores=found.scores,
            classes=self._reported[found.classes],
        )
        return named, placement, outputs[self.features][0] if self.features else None


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


def _answer(
    frame: Frame, found: Candidates, features: NDArray[np.float32], detector: Detector
) -> Detections:
    return Detections(
        header=frame.header,
        boxes=found.boxes,
        angles=found.angles,
        scores=found.scores,
        labels=found.classes.astype(np.int32),
        features=features,
        names=detector.names,
    )


def _nothing() -> Candidates:
    none = np.zeros(0, np.float32)
    return Candidates(
        boxes=np.zeros((0, 4), np.float32), angles=none, scores=none, classes=none.astype(np.intp)
    )


def _rgb(frame: Frame) -> NDArray[np.uint8]:
    if frame.pixel_format not in ("rgb8", "grey8") or frame.pixels.dtype != np.uint8:
        raise MessageError(
            f"saliency.frame: expected rgb8 or grey8 pixels, got {frame.pixel_format} "
            f"{frame.pixels.dtype}; put operators.downsample before it"
        )
    return np.asarray(frame.pixels, np.uint8)


def _input_of(
    network: Network, path: Path, settings: SaliencySettings
) -> tuple[str, tuple[int, int]]:
    """Name of the network's input and its width and height."""
    if len(network.inputs) != 1:
        raise WeightsError(f"{path}: expected one input, got {', '.join(network.inputs)}")
    name, shape = next(iter(network.inputs.items()))
    if len(shape) != 4 or shape[1] != 3:
        raise WeightsError(f"{path}: expected an input (1, 3, height, width), got {shape}")
    sides = [
        side if isinstance(side, int) else asked
        for side, asked in zip(shape[:1:-1], settings.input_px, strict=True)
    ]
    if min(sides) < 1:
        raise SettingsError(
            f"input_px: {path.name} leaves its size open: expected width and height, got "
            f"{settings.input_px}"
        )
    return name, (sides[0], sides[1])


def _is_map(shape: tuple[int, ...], size_px: tuple[int, int]) -> bool:
    cells = (size_px[1] // FEATURE_STRIDE_PX, size_px[0] // FEATURE_STRIDE_PX)
    return len(shape) == 4 and shape[2:] == cells
