"""Find and read the texts of a picture with PP-OCR: (h, w, 3) RGB -> readings.

The only module that imports rapidocr (extra `text`), which brings its networks along.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import iou
from pipeline.errors import WeightsError
from pipeline.extras import need
from pipeline.providers import PROVIDERS
from pipeline.text import harmless

Picture = NDArray[np.uint8]

LONGEST_SIDE_PX = 1600  # a larger picture is read by tiles: in one, small texts are lost
OVERLAP_PX = 200
EDGE_PX = 4  # of a tile, where a text may be cut
SAME_IOU = 0.5  # of two readings of one text
MOST_READINGS = 200  # of a picture
MOST_LETTERS = 80  # of a text
MOST_REASON = 300  # characters of what the library says


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One text in a picture."""

    text: str
    score: float  # 0..1
    box: tuple[float, float, float, float]  # xyxy, pixels of the picture


class PaddleOcr:
    """PP-OCR; it never enlarges a picture, so that what is unreadable stays so.

    The attribute `provider` says what computes its networks, by our names.
    """

    def __init__(
        self, *, threads: int = 1, least_score: float = 0.5, detection: str = "",
        recognition: str = "", least_place: float = 0.5,
    ) -> None:  # fmt: skip
        """Load the networks; raises `InstallError` and `WeightsError`."""
        need("rapidocr", "reader")
        check_files(detection=detection, recognition=recognition)
        own = {"Det.model_path": detection, "Rec.model_path": recognition}
        given: dict[str, Any] = {
            "Global.log_level": "critical",
            "Global.use_cls": False,
            "Global.text_score": least_score,
            "Global.max_side_len": LONGEST_SIDE_PX,
            "Det.limit_type": "max",  # the other kind enlarges small pictures to 736 pixels
            "Det.limit_side_len": LONGEST_SIDE_PX,
            "Det.box_thresh": least_place,
            "EngineConfig.onnxruntime.intra_op_num_threads": threads,
            "EngineConfig.onnxruntime.inter_op_num_threads": 1,
            **{name: path for name, path in own.items() if path},
        }
        try:
            from rapidocr import RapidOCR

            self._engine: Any = RapidOCR(params=given)
            blank = np.zeros((48, 96, 3), np.uint8)
            for finds in (False, True):  # it loads its networks at first use
                self._engine(blank, use_det=finds, use_cls=False, use_rec=True)
            self.provider = provider_of(self._engine)
        except Exception as error:  # it raises what its parts raise
            why = harmless(str(error), MOST_REASON)
            raise WeightsError(f"reader: PP-OCR does not load: {why}") from error

    def __call__(self, picture: Picture) -> list[Reading]:
        """Return the texts, in no order; a text across two tiles of a large picture once."""
        high, wide = picture.shape[:2]
        found: list[Reading] = []
        for top in starts(high):
            for left in starts(wide):
                tile = picture[top : top + LONGEST_SIDE_PX, left : left + LONGEST_SIDE_PX]
                within = (left, top, left + tile.shape[1], top + tile.shape[0])
                read = self._read(tile, left, top)
                found.extend(each for each in read if not cut_off(each.box, within, (wide, high)))
        return _once(found)[:MOST_READINGS]

    def places(self, picture: Picture) -> NDArray[np.float32]:
        """Return where texts are, read or not: corners (n, 4, 2), pixels of the picture."""
        found = self._engine(
            np.ascontiguousarray(picture[..., ::-1]), use_det=True, use_cls=False, use_rec=False
        )
        boxes = [] if found.boxes is None else found.boxes
        return np.asarray(boxes, np.float32).reshape(-1, 4, 2)

    def _read(self, tile: Picture, left: int, top: int) -> list[Reading]:
        # it reads BGR
        result = self._engine(
            np.ascontiguousarray(tile[..., ::-1]), use_det=True, use_cls=False, use_rec=True
        )
        if result.txts is None or result.boxes is None or result.scores is None:
            return []
        made = []
        for text, score, corners in zip(result.txts, result.scores, result.boxes, strict=True):
            (x0, y0), (x1, y1) = np.min(corners, 0), np.max(corners, 0)
            box = float(x0 + left), float(y0 + top), float(x1 + left), float(y1 + top)
            clean = harmless(str(text), MOST_LETTERS).strip()
            if clean and np.isfinite(score):
                made.append(Reading(text=clean, score=float(np.clip(score, 0, 1)), box=box))
        return made


def provider_of(engine: Any) -> str:
    """Return what the loaded networks run on; of two, each once, as in `cuda, cpu`."""
    short = {full: name for name, (full, _) in PROVIDERS.items()}
    parts = (engine.text_det, engine.text_rec)
    first = [part.session.session.get_providers()[0] for part in parts]
    return ", ".join(dict.fromkeys(short.get(full, full) for full in first))


def check_files(**networks: str) -> None:
    """Raise `WeightsError` for a file that is not there; an empty path is rapidocr's own."""
    for name, path in networks.items():
        if path and not Path(path).is_file():
            raise WeightsError(
                f"{name}: expected an ONNX file, got {path}; left empty it is rapidocr's own"
            )


def cut_off(
    box: tuple[float, ...], tile: tuple[int, int, int, int], size_px: tuple[int, int]
) -> bool:
    """Whether a text reaches an edge of its tile behind which the picture goes on."""
    left, top, right, low = tile
    return (
        (left > 0 and box[0] < left + EDGE_PX)
        or (top > 0 and box[1] < top + EDGE_PX)
        or (right < size_px[0] and box[2] > right - EDGE_PX)
        or (low < size_px[1] and box[3] > low - EDGE_PX)
    )


def _once(readings: list[Reading]) -> list[Reading]:
    """Return readings without those that a surer one overlaps."""
    kept: list[Reading] = []
    for each in sorted(readings, key=lambda reading: -reading.score):
        boxes = np.array([other.box for other in kept], np.float32).reshape(-1, 4)
        if not (iou(np.array([each.box], np.float32), boxes) > SAME_IOU).any():
            kept.append(each)
    return kept


def starts(side_px: int) -> list[int]:
    """Return where tiles of a side begin.

    >>> starts(1280), starts(4320)
    ([0], [0, 1360, 2720])
    """
    if side_px <= LONGEST_SIDE_PX:
        return [0]
    count = -(-(side_px - OVERLAP_PX) // (LONGEST_SIDE_PX - OVERLAP_PX))
    return [round(i * (side_px - LONGEST_SIDE_PX) / (count - 1)) for i in range(count)]
