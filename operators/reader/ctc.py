"""Read texts that the loop has found: ROI and tracks -> Percept, by one recogniser of lines.

Any network that turns a line of text into letters at positions (CTC) will do: PP-OCR's recogniser,
by default, or that of another package as an ONNX file. It reads only where a track is, so that it
costs a fraction of `Reader`, and finds nothing that the detector of texts has not found.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from operators.reader.ocr import MOST_LETTERS, Reading
from operators.reader.reader import Reads, TextReader, check_reader
from pipeline import Frame, SettingsError
from pipeline.boxes import boxes_at, covered, in_picture
from pipeline.errors import WeightsError
from pipeline.inference import Network
from pipeline.providers import NetworkSettings
from pipeline.text import harmless

Picture = NDArray[np.uint8]

LINE_PX = 48  # height where the network leaves it open
LEAST_WIDE_PX, MOST_WIDE_PX = 48, 960  # of a line at that height
BLANK = 0  # the class that is no letter
MOST_CHANCE = 1.01  # of a letter, as networks round
MOST_LINES = 24  # read in one frame
INSIDE = 0.9  # share of a track that the ROI must show
MARGIN = 0.12  # around a track's box, of its height


@dataclass(frozen=True, kw_only=True)
class OnnxReaderSettings(NetworkSettings):
    """What a graph may set."""

    # an ONNX file (1, 3, h, w) -> (1, positions, letters); empty: PP-OCR's, of rapidocr
    weights: str = ""
    letters: str = ""  # file with a letter a line; empty: `character` in the file's metadata
    reads: Reads = "roi"
    least_score: float = 0.6
    forget_after: int = 60

    def __post_init__(self) -> None:
        NetworkSettings.__post_init__(self)
        check_reader(self.reads, self.least_score, self.threads, self.forget_after)


S = TypeVar("S", bound=OnnxReaderSettings)


class LineReader(TextReader[S]):
    """Reads lines of text at known places; a class for one kind of place implements `read`."""

    @classmethod
    def advise(cls, settings: S, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `WeightsError` for a network that reads no lines."""
        recogniser_of(settings)
        return ()

    def open(self) -> None:
        """Load the network; raises `WeightsError` for one without letters of its own."""
        self.reads, self.forget_after = self.settings.reads, self.settings.forget_after
        super().open()
        self._recogniser = recogniser_of(self.settings)

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._recogniser.provider


class OnnxReader(LineReader[OnnxReaderSettings]):
    """Reads the tracks that are in the picture."""

    def read(self, frame: Frame) -> list[Reading]:
        """Read each track that the picture shows nearly whole, the surest first."""
        if self._tracks is None or not len(self._tracks.ids):
            return []
        boxes = boxes_at(self._tracks, frame.header.seq)  # the tracks may be of an earlier frame
        if boxes is None:
            return []
        shown = covered(boxes, np.array(frame.window, np.float32)) >= INSIDE
        rows = np.flatnonzero(shown)
        rows = rows[np.argsort(-self._tracks.scores[rows], kind="stable")][:MOST_LINES]
        pixels = np.asarray(frame.pixels, np.uint8)
        found = []
        for row in rows:
            box = in_picture(boxes[row], frame)
            text, score = self._recogniser(cut(pixels, box))
            if text and score >= self.settings.least_score:
                left, top, right, low = box.tolist()
                found.append(Reading(text=text, score=score, box=(left, top, right, low)))
        return found


class Recogniser:
    """Reads one line of text: a picture (h, w, 3) RGB -> its text and how sure that is."""

    def __init__(self, network: Network, letters: str = "") -> None:
        self._network, self.provider = network, network.provider
        self._name = next(iter(network.inputs))
        shape = network.inputs[self._name]
        if len(shape) != 4 or len(network.inputs) != 1:
            raise WeightsError(f"{network.path}: expected one input (n, 3, h, w), got {shape}")
        self._height = shape[2] if isinstance(shape[2], int) else LINE_PX
        self._letters = letters_of(network, letters)

    def __call__(self, line: Picture) -> tuple[str, float]:
        """Return text and score; an empty text where nothing is read."""
        if min(line.shape[:2]) < 2:
            return "", 0.0
        wide = math.ceil(line.shape[1] / line.shape[0] * self._height)
        size = min(max(wide, LEAST_WIDE_PX), MOST_WIDE_PX), self._height
        scaled = cv2.resize(line[..., ::-1], size, interpolation=cv2.INTER_LINEAR)
        given = (scaled.astype(np.float32) / 127.5 - 1).transpose(2, 0, 1)[None]
        out = next(iter(self._network({self._name: np.ascontiguousarray(given)}).values()))
        if out.ndim != 3 or out.shape[2] != len(self._letters) + 1:
            raise WeightsError(
                f"{self._network.path}: expected an output (1, n, {len(self._letters) + 1}) for "
                f"{len(self._letters)} letters, got {out.shape}"
            )
        return decoded(out[0], self._letters)


def recogniser_of(settings: OnnxReaderSettings) -> Recogniser:
    """Return what reads a line; raises `WeightsError` and `SettingsError`."""
    network = Network(weights_of(settings.weights), **settings.compute)
    return Recogniser(network, settings.letters)


def decoded(chances: NDArray[np.float32], letters: tuple[str, ...]) -> tuple[str, float]:
    """Return the text of probabilities (positions, 1 + letters) and its mean score.

    Repetitions count once unless a blank, class 0, is between them. Of a network that ends before
    the softmax the probabilities are computed: its own numbers would all be sure readings.

    >>> table = np.eye(3, dtype=np.float32)[[1, 1, 0, 1, 2]]
    >>> decoded(table, ("A", "B"))
    ('AAB', 1.0)
    """
    if chances.min(initial=0) < 0 or chances.max(initial=0) > MOST_CHANCE:
        chances = softmax(chances, axis=1)
    best, score = chances.argmax(1), chances.max(1)
    new = np.concatenate([[True], best[1:] != best[:-1]]) & (best != BLANK)
    if not new.any():
        return "", 0.0
    text = "".join(letters[i - 1] for i in best[new])
    return harmless(text, MOST_LETTERS).strip(), float(np.clip(score[new].mean(), 0, 1))


def letters_of(network: Network, file: str) -> tuple[str, ...]:
    """Return the letters of a recogniser, a space last; raises `WeightsError`."""
    if file:
        try:
            text = Path(file).read_text(encoding="utf-8")
        except (OSError, UnicodeError) as error:
            raise WeightsError(f"letters: {file}: expected a letter a line: {error}") from error
    else:
        text = network.metadata.get("character", "")
    found = tuple(line for line in text.split("\n") if line)
    if not found:
        raise WeightsError(
            f"letters: expected a file with a letter a line for {network.path.name}, got none"
        )
    return (*found, " ")


def weights_of(weights: str) -> Path:
    """Return the file to load; raises `WeightsError` and `SettingsError`."""
    if weights:
        if not Path(weights).is_file():
            raise WeightsError(f"weights: expected an ONNX file, got {weights}")
        return Path(weights)
    spec = find_spec("rapidocr")
    folders = [Path(p) / "models" for p in (spec.submodule_search_locations or ())] if spec else []
    found = sorted(path for folder in folders for path in folder.glob("*_rec_*.onnx"))
    if not found:
        raise SettingsError("weights: expected an ONNX file, or pip install 'fovea[text]'")
    return found[-1]


def cut(pixels: Picture, box: NDArray[np.float32]) -> Picture:
    """Return what is in a box and a little around it, clipped at the picture."""
    margin = MARGIN * float(box[3] - box[1])
    x0, y0 = np.maximum(np.floor(box[:2] - margin), 0).astype(int)
    x1, y1 = np.ceil(box[2:] + margin).astype(int)
    return pixels[y0 : max(y0, y1), x0 : max(x0, x1)]
