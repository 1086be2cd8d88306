"""A detector as an ONNX file: RGB picture in, objects and a feature map out.

Some read what changed since the frame before as well (difference.py).

The file, a side file and the settings say together what the network's input and output are.
"""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from operators.saliency.classes import report_as, thresholds
from operators.saliency.decode import (
    Candidates,
    Grid,
    Kind,
    class_count,
    decode_end2end,
    decode_yolo,
    decode_yolox,
    fits,
    kind_of,
    suppress,
    usable,
    yolox_grid,
)
from operators.saliency.description import MOST_PX, Description, described, side_file
from operators.saliency.letterbox import Letterbox, Placement
from pipeline import SettingsError, WeightsError
from pipeline.contract import HEADLINE
from pipeline.inference import HALF, Network
from pipeline.weights import weights_file

if TYPE_CHECKING:
    from operators.saliency.saliency import SaliencySettings

SHIPPED = Path(__file__).with_name("detector.onnx")
EIGHT_BITS = Path(__file__).with_name("detector_int8.onnx")  # the same in half the time
# in eight bits, trained for 736x416 and 480x288: enlarged contexts and regions of interest; crowds
# was also shown people before one another; moving is crowds, trained on for a ball at the poles of
# corner flags, and with a second head for one that moves
LARGER = Path(__file__).with_name("detector_larger.onnx")
CROWDS = Path(__file__).with_name("detector_crowds.onnx")
MOVING = Path(__file__).with_name("detector_moving.onnx")
# eight bits with another head for the ball, which has seen it at the poles of corner flags
CORNERS = Path(__file__).with_name("detector_corners.onnx")
ROI = Path(__file__).with_name("detector_roi.onnx")  # in eight bits, for full resolution in 384x224
OBJECTS = Path(__file__).parent / "objects" / "objects.onnx"  # what a robot handles
TEXT = Path(__file__).with_name("text.onnx")  # texts in streets, as turned boxes
NAMED = {
    "": SHIPPED, "eight_bits": EIGHT_BITS, "moving": MOVING, "larger": LARGER, "crowds": CROWDS,
    "corners": CORNERS, "roi": ROI, "objects": OBJECTS, "text": TEXT,
}  # fmt: skip
FEATURE_STRIDE_PX = 8
USUAL_CONFIDENCE = 0.25
INPUT_TYPES = ("tensor(float)", HALF)
Array = NDArray[np.float32]
log = logging.getLogger(__name__)


class Detector:
    """A network together with what is known of it.

    `names` are the reported classes, `size_px` is width and height of the input, `channels` the
    length of features; `reads_difference` tells whether `look` needs what changed. Raises
    `WeightsError` for a file that is no detector and for what contradicts it, `SettingsError` for
    settings that do.
    """

    def __init__(self, settings: "SaliencySettings") -> None:
        self.settings = settings
        self.unusable = 0  # boxes so far
        self.path = weights_file(settings.weights, NAMED)
        self.network = Network(self.path, **settings.compute)
        self.known = described(self.path, self.network.metadata)
        self.input, self.size_px = _input_of(self.network, settings, self.known)
        self.reads_difference = self.known.difference
        # whether other settings may ask for another size
        self.open_sides = any(isinstance(n, str) for n in self.network.inputs[self.input][2:])
        size_px = self.size_px
        # one run on an empty picture tells the shapes of exports with open sides
        planes = 4 if self.reads_difference else 3
        blank = np.zeros((1, planes, size_px[1], size_px[0]), np.float32)
        shapes = {name: a.shape for name, a in self.network({self.input: blank}).items()}
        self.output = next(iter(shapes))
        shape = shapes[self.output]
        self.kind = self._kind(shape, size_px)
        self.features = next((n for n, s in shapes.items() if _is_map(s, size_px)), None)
        self.channels = shapes[self.features][1] if self.features else 0
        own = self._names(class_count(shape, self.kind))
        self.names, self._reported = report_as(own, settings.names)
        told = [self.names[row] if row >= 0 else "" for row in self._reported]
        self._thresholds = thresholds(
            own, self._own_thresholds(), told, settings.class_confidence, self._usual()
        )
        self._grid: Grid | None = yolox_grid(*size_px) if self.kind == "yolox" else None
        raw = self.kind in ("yolox", "yolox_decoded")
        self._box = Letterbox(
            *size_px, scale=1 if raw else 1 / 255, bgr=raw, corner=raw, keep=self.open_sides,
            difference=self.reads_difference,
        )  # fmt: skip

    def look(
        self, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None = None
    ) -> tuple[Candidates, Placement, Array | None]:
        """Objects in input pixels with reported classes, the placement and the feature map.

        `difference` (h, w): levels by which the picture changed, for a network that reads them;
        none where that is not known.
        """
        placement = self._box.put(picture, difference)
        outputs = self.network({self.input: self._box.tensor})
        found = self._usable(outputs[self.output][0])
        kept = suppress(found, self.settings.nms_iou, agnostic=self.settings.class_agnostic)
        found = found.take(kept[: self.settings.max_objects])
        named = replace(found, classes=self._reported[found.classes])
        return named, placement, outputs[self.features][0] if self.features else None

    def confidence_of(self, name: str) -> float:
        """Return the least confidence with which a class is reported."""
        return float(self._thresholds[self._reported == self.names.index(name)].min())

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on, and how many boxes were left out because they are none."""
        found: dict[str, Any] = dict(self.network.where())
        if self.unusable:
            found["unusable_boxes"] = self.unusable
            told = f"{self.unusable} boxes of {self.path.name} were unusable, as the log says"
            found[HEADLINE] = told
        return found

    def _usable(self, output: Array) -> Candidates:
        # numbers that overflow, or are none, give boxes that are left out
        with np.errstate(over="ignore", invalid="ignore"):
            found = self._decoded(output)
        good = usable(found)
        if not good.all():
            bad = int((~good).sum())
            if not self.unusable:
                log.warning(
                    "%s: expected finite boxes with sides above 0 and scores within 0..1, got %d "
                    "others in one picture; they are left out, as are later ones",
                    self.path,
                    bad,
                )
            self.unusable += bad
            found = found.take(good)
        return replace(found, scores=np.minimum(found.scores, 1))

    def _decoded(self, output: Array) -> Candidates:
        if self.kind in ("yolox", "yolox_decoded"):
            return decode_yolox(output, self._thresholds, self._grid)
        if self.kind == "end2end":
            return decode_end2end(output, self._thresholds)
        return decode_yolo(output, self._thresholds, turned=self.kind == "obb")

    def _kind(self, shape: tuple[int, ...], size_px: tuple[int, int]) -> Kind:
        asked = self.known.format if self.settings.format == "auto" else self.settings.format
        if asked == "auto":
            try:
                return kind_of(shape, size_px, self.known.task)
            except WeightsError as error:
                raise WeightsError(f"{self.path}: {error}") from error
        if not fits(shape, asked, size_px):
            raise WeightsError(f"{self.path}: expected an output of format {asked}, got {shape}")
        return asked

    def _names(self, count: int) -> tuple[str, ...]:
        """The network's own class names; numbers where nothing names them."""
        names = self.known.names
        if not count and not names:
            side = side_file(self.path).name
            raise WeightsError(
                f"{self.path}: expected names of its classes in its metadata or in {side}, because "
                "the output of format end2end does not tell how many they are, got none"
            )
        if count and names and len(names) != count:
            what = f"{count} names, as {self.path.name} has classes"
            raise WeightsError(f"{self.known.places['names']}: expected {what}, got {len(names)}")
        return names or tuple(str(number) for number in range(count))

    def _own_thresholds(self) -> dict[str, float]:
        return {} if self.settings.confidence else dict(self.known.class_confidence)

    def _usual(self) -> float:
        return self.settings.confidence or self.known.confidence or USUAL_CONFIDENCE


def _input_of(
    network: Network, settings: "SaliencySettings", known: Description
) -> tuple[str, tuple[int, int]]:
    """Name of the network's input and its width and height."""
    path = network.path
    if len(network.inputs) != 1:
        raise WeightsError(f"{path}: expected one input, got {', '.join(network.inputs) or 'none'}")
    name, shape = next(iter(network.inputs.items()))
    batch = shape[0] if shape and isinstance(shape[0], int) else 1
    planes = 4 if known.difference else 3
    if len(shape) != 4 or shape[1] != planes or batch != 1:
        told = (
            f", as its metadata {'says' if known.difference else 'does not say'} difference: True"
        )
        why = told if len(shape) == 4 and {planes, shape[1]} == {3, 4} else ""
        what = f"an input (1, {planes}, height, width){why}"
        raise WeightsError(f"{path}: expected {what}, got {shape}")
    if (kind := network.input_types[name]) not in INPUT_TYPES:
        raise WeightsError(f"{path}: expected an input of {' or '.join(INPUT_TYPES)}, got {kind}")
    fixed = tuple(side if isinstance(side, int) and side > 0 else 0 for side in shape[:1:-1])
    return name, _size(path, (fixed[0], fixed[1]), settings.input_px, known)


def _size(
    path: Path, fixed: tuple[int, int], asked: tuple[int, int], known: Description
) -> tuple[int, int]:
    """Width and height of the input: `fixed` where not 0, else as asked for, or as exported."""
    wanted = asked if any(asked) else known.input_px
    usual = wanted if any(wanted) else known.exported_px
    size_px = (fixed[0] or usual[0], fixed[1] or usual[1])
    said = "input_px" if any(asked) else known.places.get("input_px", "input_px")
    wrong = SettingsError if any(asked) or not any(wanted) else WeightsError
    if min(size_px) < 1:
        side = side_file(path).name
        raise SettingsError(
            f"input_px: {path.name} leaves the size of its input open: expected width and height "
            f"here or in {side}, got neither"
        )
    if max(size_px) > MOST_PX:
        raise WeightsError(f"{path}: expected an input of up to {MOST_PX} pixels, got {size_px}")
    if any(wanted) and size_px != wanted:
        width_px, height_px = size_px
        what = f"the input of {path.name} is {width_px}x{height_px}"
        # a graph that names a size cannot be told to name none
        setting = f", as by --set NODE.input_px=[{width_px},{height_px}]"
        remedy = setting if any(asked) else " or nothing"
        raise wrong(f"{said}: {what}, expected that{remedy}, got {wanted}")
    if not all(fixed) and any(side % known.stride_px for side in size_px):
        what = f"expected multiples of {known.stride_px} for {path.name}"
        raise wrong(f"{said}: {what}, got {size_px}")
    return size_px


def _is_map(shape: tuple[int, ...], size_px: tuple[int, int]) -> bool:
    cells = (size_px[1] // FEATURE_STRIDE_PX, size_px[0] // FEATURE_STRIDE_PX)
    return len(shape) == 4 and shape[2:] == cells
