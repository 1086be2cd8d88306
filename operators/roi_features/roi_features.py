"""Encode tracked objects at full resolution: ROI Frame and Tracks -> RoiFeatures.

A sensor that reads several windows in one exposure sends the others as `roi_2` to `roi_4`.

Each track inside the ROI is cropped, scaled to the encoder's square and encoded, in one batch if
the network allows. A network with a second output, `classes`, also verifies: it gives the
probability that each object is of its labelled class.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.roi_features.crops import LEAST_PX, cut, to_squares
from pipeline import (
    Frame,
    Input,
    MessageError,
    Operator,
    RoiFeatures,
    SettingsError,
    Tracks,
    WeightsError,
)
from pipeline.boxes import covered
from pipeline.inference import Network
from pipeline.providers import NetworkSettings
from pipeline.weights import weights_file

FURTHER_WAIT_MS = 50.0  # realtime: for further windows of an exposure, where they are connected
SHIPPED = Path(__file__).with_name("roi_encoder.onnx")


@dataclass(frozen=True, kw_only=True)
class RoiEncoderSettings(NetworkSettings):
    """What a graph may set."""

    # an ONNX file (n, 3, s, s) -> (n, d[, h, w]), or a name that `fovea weights` knows; empty: the
    # shipped one
    weights: str = ""
    crop_px: int = 96  # side s where the network leaves it open
    margin: float = 0.15  # added to the box's longer side
    least_px: float = LEAST_PX  # of a crop's side, ROI pixels
    inside: float = 0.5  # least share of a box that the ROI must show
    max_objects: int = 25  # best ones, by score
    batch: int = 0  # crops a call; 0: as the network says, all at once where it leaves it open
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of RGB 0..1, subtracted first
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)  # then divided by; 1/255 gives 0..255
    bgr: bool = False  # order of the channels that the network expects

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {"crop_px": self.crop_px, "max_objects": self.max_objects}
        for name, value in counts.items():
            if value < 1:
                raise SettingsError(f"{name}: must be at least 1, got {value}")
        if self.batch < 0:
            raise SettingsError(f"batch: must not be negative, got {self.batch}")
        if not 0 < self.inside <= 1:
            raise SettingsError(f"inside: must be above 0 and at most 1, got {self.inside}")
        for name, number in {"margin": self.margin, "least_px": self.least_px}.items():
            if number < 0:
                raise SettingsError(f"{name}: must not be negative, got {number}")
        if min(self.std) <= 0:
            raise SettingsError(f"std: must be above 0, got {self.std}")


class RoiEncoder(Operator[RoiEncoderSettings, RoiFeatures]):
    """Sends one message per exposure, with empty arrays (0, d) without a track in the ROI."""

    roi = Input(Frame, keep="latest")
    tracks = Input(Tracks, keep="latest")
    roi_2 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)
    roi_3 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)
    roi_4 = Input(Frame, keep="latest", optional=True, wait_ms=FURTHER_WAIT_MS)

    def open(self) -> None:
        self._encoder = Encoder(self.settings)

    def summary(self) -> Mapping[str, Any]:
        """What the network runs on."""
        return self._encoder.network.where()

    def headline(self) -> str:
        """What the network runs on, where it is not the CPU."""
        return self._encoder.network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._encoder.network.provider

    def state(self) -> None:
        """Return None: only scratch memory changes."""

    def on_roi_tracks(self, roi: Frame, tracks: Tracks) -> RoiFeatures:
        return self.on_roi_tracks_roi_2_roi_3_roi_4(roi, tracks)

    def on_roi_tracks_roi_2(self, roi: Frame, tracks: Tracks, roi_2: Frame | None) -> RoiFeatures:
        return self.on_roi_tracks_roi_2_roi_3_roi_4(roi, tracks, roi_2)

    def on_roi_tracks_roi_2_roi_3(
        self, roi: Frame, tracks: Tracks, roi_2: Frame | None, roi_3: Frame | None
    ) -> RoiFeatures:
        return self.on_roi_tracks_roi_2_roi_3_roi_4(roi, tracks, roi_2, roi_3)

    def on_roi_tracks_roi_2_roi_3_roi_4(
        self,
        roi: Frame,
        tracks: Tracks,
        roi_2: Frame | None = None,
        roi_3: Frame | None = None,
        roi_4: Frame | None = None,
    ) -> RoiFeatures:
        """Encode each track in the window that shows most of it."""
        frames = [frame for frame in (roi, roi_2, roi_3, roi_4) if frame is not None]
        for frame in frames:
            check_pixels(frame)
        rows, places = self._inside(frames, tracks)
        encoder = self._encoder
        features = np.zeros((len(rows), encoder.channels), np.float32)
        logits = np.zeros((len(rows), len(encoder.names)), np.float32)
        for place, frame in enumerate(frames):
            own = places == place
            features[own], logits[own] = encoder(frame, tracks.boxes[rows[own], -1])
        labels = [tracks.name_of(int(row)) for row in rows]
        return RoiFeatures(
            header=roi.header,
            ids=tracks.ids[rows],
            features=features,
            genuine=verdicts(logits, encoder.names, labels),
        )

    def _inside(
        self, frames: Sequence[Frame], tracks: Tracks
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the tracks to encode, in their own order, and the frame of each."""
        shares = np.zeros((len(frames), len(tracks.ids)), np.float32)
        for place, frame in enumerate(frames):
            if frame.pixels.size and len(tracks.ids):
                window = np.array(frame.window, np.float32)
                shares[place] = covered(tracks.boxes[:, -1], window)
        rows = np.flatnonzero(shares.max(0) >= self.settings.inside)
        best = np.argsort(-tracks.scores[rows], kind="stable")[: self.settings.max_objects]
        rows = np.sort(rows[best])
        return rows, shares[:, rows].argmax(0)


def check_pixels(roi: Frame) -> None:
    """Raise `MessageError` for pixels that are not RGB of 8 bit."""
    if roi.pixels.size and (roi.pixels.ndim != 3 or roi.pixels.dtype != np.uint8):
        raise MessageError(
            f"roi_features.roi: expected rgb8 pixels, got {roi.pixel_format} "
            f"{roi.pixels.dtype}; put operators.downsample before it"
        )


class Encoder:
    """A network that describes square crops, and the memory it reads them from.

    `channels` is d; `names` are the k classes it tells apart, none where it does not.
    """

    def __init__(self, settings: RoiEncoderSettings) -> None:
        self._settings = settings
        path = weights_file(settings.weights, {"": SHIPPED})
        self.network = Network(path, **settings.compute)
        if len(self.network.inputs) != 1:
            raise WeightsError(f"{path}: expected one input, got {', '.join(self.network.inputs)}")
        self._input, shape = next(iter(self.network.inputs.items()))
        if len(shape) != 4 or shape[1] != 3:
            raise WeightsError(f"{path}: expected an input (n, 3, s, s), got {shape}")
        count, _, height_px, width_px = (s if isinstance(s, int) else 0 for s in shape)
        size_px = (width_px or settings.crop_px, height_px or settings.crop_px)
        # an open batch takes all objects at once; a fixed one is filled again and again
        self._at_once = count or settings.batch or settings.max_objects
        self._open = not (count or settings.batch)
        self._batch = np.zeros((self._at_once, 3, size_px[1], size_px[0]), np.float32)
        self._size_px = size_px
        order = [2, 1, 0] if settings.bgr else [0, 1, 2]
        self._scale = (1 / (255 * np.array(settings.std, np.float32)))[order, None, None]
        self._shift = (-np.array(settings.mean) / settings.std).astype(np.float32)[
            order, None, None
        ]
        first, classes = self._run(1 if self._open else self._at_once)
        if first.ndim != 2:
            raise WeightsError(f"{path}: expected an output (n, d) or (n, d, h, w)")
        self.channels = first.shape[1]
        self.names = self.network.metadata.get("classes", "").split()
        if classes.shape[1] != len(self.names):
            raise WeightsError(
                f"{path}: expected names of {classes.shape[1]} classes in its metadata, "
                f"got {len(self.names)}"
            )

    def __call__(
        self, roi: Frame, boxes: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Boxes (n, 4) in sensor pixels -> features (n, d), logits of `names` (n, k)."""
        features = np.zeros((len(boxes), self.channels), np.float32)
        logits = np.zeros((len(boxes), len(self.names)), np.float32)
        if not len(boxes):
            return features, logits
        squares = to_squares(boxes, roi, self._settings.margin, self._settings.least_px)
        for start in range(0, len(boxes), self._at_once):
            part = squares[start : start + self._at_once]
            for row, crop in enumerate(cut(np.asarray(roi.pixels, np.uint8), part, self._size_px)):
                planes = (crop[..., ::-1] if self._settings.bgr else crop).transpose(2, 0, 1)
                np.multiply(planes, self._scale, out=self._batch[row])
            if self._shift.any():
                self._batch[: len(part)] += self._shift
            answer, classes = self._run(len(part) if self._open else self._at_once)
            features[start : start + len(part)] = answer[: len(part)]
            logits[start : start + len(part)] = classes[: len(part)]
        return features, logits

    def _run(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Features and logits of classes, (n, 0) where the network has none."""
        answers = self.network({self._input: self._batch[:count]})
        features = next(iter(answers.values()))
        classes = answers.get("classes", np.zeros((count, 0), np.float32))
        return (features.mean((2, 3)) if features.ndim == 4 else features), classes


def verdicts(
    logits: NDArray[np.float32], names: Sequence[str], labels: Sequence[str]
) -> NDArray[np.float32]:
    """Return the probability (n,) that each object is of its labelled class, from logits (n, k).

    1 for a label that is not among the names.
    """
    raised = np.exp(logits - logits.max(1, initial=0, keepdims=True))
    found = [
        row[names.index(label)] / row.sum() if label in names else 1.0
        for row, label in zip(raised, labels, strict=True)
    ]
    return np.array(found, np.float32)
