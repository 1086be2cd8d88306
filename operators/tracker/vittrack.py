"""A template tracker by network (ViTTrack, `vitTracker.onnx`): look -> box and score.

The network compares a 128 px template with a 256 px search picture and returns three 16x16 maps.
Sizes, factors, mean and deviation, and the meaning of the maps are those of OpenCV's `TrackerVit`
(Apache-2.0), against which this is tested with the same weights.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.tracker.following import Memory, Method
from operators.tracker.look import Streams, normalise, size_of
from operators.tracker.tracker import Tracker, TrackerSettings
from pipeline.boxes import centres, from_centres
from pipeline.errors import WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO, NetworkSettings
from pipeline.weights import require

TEMPLATE_PX, SEARCH_PX, CELLS = 128, 256, 16
TEMPLATE_FACTOR, SEARCH_FACTOR = 2, 4  # side of a look in box sizes
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


@dataclass(frozen=True, kw_only=True)
class VitTrackerSettings(TrackerSettings, NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file; empty: what `fovea weights pull vittrack` fetched

    def __post_init__(self) -> None:
        TrackerSettings.__post_init__(self)
        NetworkSettings.__post_init__(self)


class VitTracker(Tracker[VitTrackerSettings]):
    """Follows with ViTTrack, and with nothing else: missing weights are a `WeightsError`."""

    @classmethod
    def advise(cls, settings: VitTrackerSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `WeightsError` for weights that are not there."""
        weights_of(settings)
        return ()

    def method(self) -> Method:
        """ViTTrack; raises `WeightsError`."""
        return VitTrack(weights_of(self.settings), **self.settings.compute)


class VitTrack:
    """Follows one object; the template stays what it was at the start."""

    patience_score = 0.2  # below this the object is not there (OpenCV: "filters black frames")

    def __init__(
        self, weights: Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        self._network = Network(weights, threads=threads, provider=provider, device=device)
        self.provider = self._network.provider
        for name, side in (("template", TEMPLATE_PX), ("search", SEARCH_PX)):
            if self._network.inputs.get(name) != [1, 3, side, side]:
                raise WeightsError(
                    f"{weights}: expected an input {name} of 1x3x{side}x{side}, "
                    f"got {self._network.inputs}"
                )
        # one past each end: the outermost cells keep some weight
        ramp = np.hanning(CELLS + 2)[1:-1].astype(np.float32)
        self._window = np.outer(ramp, ramp)
        self._search = np.empty((1, 3, SEARCH_PX, SEARCH_PX), np.float32)
        self._template = np.empty((1, 3, TEMPLATE_PX, TEMPLATE_PX), np.float32)

    def start(self, streams: Streams, box: Box) -> None:
        """Take the template."""
        side = TEMPLATE_FACTOR * size_of(box)
        normalise(streams.look(centres(box), side, TEMPLATE_PX), self._template)

    def memory(self) -> Memory:
        """The template, as the network takes it."""
        return (self._template,)

    def resume(self, memory: Memory) -> bool:
        """Take over another instance's memory."""
        if [part.shape for part in memory] != [self._template.shape]:
            return False
        self._template[:] = memory[0]
        return True

    def aligned(self, box: Box, foreseen: Box) -> Box:
        """Return the box unchanged: it is more accurate than the prediction."""
        return box

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        """Return the object's box, given the previous one, and a confidence 0..1."""
        side = SEARCH_FACTOR * size_of(box)
        normalise(streams.look(centres(box), side, SEARCH_PX), self._search)
        maps = self._network({"template": self._template, "search": self._search})
        found, score = decode(maps["output1"], maps["output2"], maps["output3"], self._window)
        corner = centres(box) - side / 2
        return (found * side + np.tile(corner, 2)).astype(np.float32), score


def weights_of(settings: VitTrackerSettings) -> Path:
    """The file to load; raises `WeightsError` with the command that gets it."""
    if not settings.weights:
        return require("vittrack")
    path = Path(settings.weights)
    if not path.is_file():
        raise WeightsError(
            f"weights: expected an ONNX file, got {path}; without one named, what "
            "`fovea weights pull vittrack` fetched is used"
        )
    return path


def decode(
    confidence: NDArray[np.float32],  # (1, 1, 16, 16)
    sides: NDArray[np.float32],  # (1, 2, 16, 16) width, height in looks
    offsets: NDArray[np.float32],  # (1, 2, 16, 16) x, y in cells
    window: NDArray[np.float32],  # (16, 16)
) -> tuple[Box, float]:
    """The best box, in units of the look's side, and its windowed confidence."""
    weighted = confidence[0, 0] * window
    row, column = np.unravel_index(int(weighted.argmax()), weighted.shape)
    centre = (np.array([column, row]) + offsets[0, :, row, column]) / CELLS
    box = from_centres(centre.astype(np.float32), sides[0, :, row, column])
    return box, float(weighted[row, column])
