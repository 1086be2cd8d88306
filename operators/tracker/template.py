"""A template tracker that ships with its network: look -> box and a score that says `absent`.

The network (`template.onnx`, trained by `operators.tracker.train`) compares a 64 px template with a
128 px search picture at the same scale and returns three 16x16 maps and the probability that the
object is in the search picture.
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

TEMPLATE_PX, SEARCH_PX, CELLS = 64, 128, 16
TEMPLATE_FACTOR, SEARCH_FACTOR = 2, 4  # side of a look in box sizes
SHIPPED = Path(__file__).with_name("template.onnx")
WINDOW_WEIGHT = 0.3  # of the preference for places near the previous one
SIZE_GAIN = 0.3  # share of the change of size that is taken over: a size changes slowly
INPUTS = {
    "template": [1, 3, TEMPLATE_PX, TEMPLATE_PX],
    "shape": [1, 2],
    "search": [1, 3, SEARCH_PX, SEARCH_PX],
}
OUTPUTS = {
    "heat": [1, 1, CELLS, CELLS],
    "sizes": [1, 2, CELLS, CELLS],
    "offsets": [1, 2, CELLS, CELLS],
    "score": [1, 1],
}
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


@dataclass(frozen=True, kw_only=True)
class TemplateTrackerSettings(TrackerSettings, NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file; empty: the shipped one

    def __post_init__(self) -> None:
        TrackerSettings.__post_init__(self)
        NetworkSettings.__post_init__(self)


class TemplateTracker(Tracker[TemplateTrackerSettings]):
    """Follows with the shipped network, or with another of the same training."""

    @classmethod
    def advise(
        cls, settings: TemplateTrackerSettings, upstream: Mapping[str, Any]
    ) -> Iterable[str]:
        """Nothing; raises `WeightsError` for weights that are not there."""
        weights_of(settings)
        return ()

    def method(self) -> Method:
        """The template; raises `WeightsError`."""
        return Template(weights_of(self.settings), **self.settings.compute)


class Template:
    """Follows one object; the template stays what it was at the start."""

    patience_score = 0.3

    def __init__(
        self, weights: Path = SHIPPED, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        self._network = Network(weights, threads=threads, provider=provider, device=device)
        self.provider = self._network.provider
        for what, wanted, got in (
            ("inputs", INPUTS, self._network.inputs),
            ("outputs", OUTPUTS, self._network.outputs),
        ):
            if wanted != got:
                raise WeightsError(f"{weights}: expected {what} {wanted}, got {got}")
        ramp = np.hanning(CELLS + 2)[1:-1].astype(np.float32)
        self._window = 1 - WINDOW_WEIGHT * (1 - np.outer(ramp, ramp))
        self._search = np.empty((1, 3, SEARCH_PX, SEARCH_PX), np.float32)
        self._template = np.empty((1, 3, TEMPLATE_PX, TEMPLATE_PX), np.float32)
        self._shape = np.zeros((1, 2), np.float32)

    def start(self, streams: Streams, box: Box) -> None:
        """Take the template."""
        side = TEMPLATE_FACTOR * size_of(box)
        normalise(streams.look(centres(box), side, TEMPLATE_PX), self._template)
        self._shape[0] = shape_of(box)

    def memory(self) -> Memory:
        """The template, as the network takes it, and its shape."""
        return self._template, self._shape

    def resume(self, memory: Memory) -> bool:
        """Take over another instance's memory."""
        if [part.shape for part in memory] != [self._template.shape, self._shape.shape]:
            return False
        self._template[:], self._shape[:] = memory
        return True

    def aligned(self, box: Box, foreseen: Box) -> Box:
        """Return the box unchanged: the network has learned where an object ends."""
        return box

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        """Return the object's box, given the previous one, and a confidence 0..1.

        Where no picture shows the surroundings of the previous one, it stays, with confidence 0.
        """
        side = SEARCH_FACTOR * size_of(box)
        look = streams.look(centres(box), side, SEARCH_PX)
        if not look.any():
            return box, 0.0
        normalise(look, self._search)
        maps = self._network(
            {"template": self._template, "shape": self._shape, "search": self._search}
        )
        centre, size = decode(maps["heat"], maps["sizes"], maps["offsets"], self._window)
        before = box[2:] - box[:2]
        # by ratio, so that no size becomes negative; the floor keeps a look from vanishing
        grown = np.maximum(before, 1) ** (1 - SIZE_GAIN) * np.maximum(size * side, 1) ** SIZE_GAIN
        place = centres(box) + (centre - 0.5) * side
        found = from_centres(place.astype(np.float32), grown.astype(np.float32))
        return found, float(np.clip(maps["score"][0, 0], 0, 1))


def weights_of(settings: TemplateTrackerSettings) -> Path:
    """The file to load; raises `WeightsError` for one that is not there."""
    path = Path(settings.weights) if settings.weights else SHIPPED
    if not path.is_file():
        raise WeightsError(f"weights: expected an ONNX file, got {path}")
    return path


def shape_of(box: Box) -> NDArray[np.float32]:
    """Log of width and height over the root of the area: (2,), 0 for a square.

    >>> np.exp(shape_of(np.array([0, 0, 10, 40], np.float32))).round(2).tolist()
    [0.5, 2.0]
    """
    sides = np.maximum(box[2:] - box[:2], 1)
    return np.asarray(np.log(sides) - np.log(sides).mean(), np.float32)


def decode(
    heat: NDArray[np.float32],  # (1, 1, 16, 16)
    sizes: NDArray[np.float32],  # (1, 2, 16, 16) width, height in looks
    offsets: NDArray[np.float32],  # (1, 2, 16, 16) x, y in cells, from a cell's middle
    window: NDArray[np.float32],  # (16, 16)
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centre (x, y) and size (width, height) at the best cell, in units of the look's side."""
    weighted = heat[0, 0] * window
    row, column = np.unravel_index(int(weighted.argmax()), weighted.shape)
    centre = (np.array([column, row], np.float32) + 0.5 + offsets[0, :, row, column]) / CELLS
    return centre.astype(np.float32), sizes[0, :, row, column]
