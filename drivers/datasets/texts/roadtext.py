"""A clip of RoadText-1K, of either release: a video and its truth in, pictures and truth out.

The original release has a list of frames with `labels` and a second file of transcriptions by id;
the challenge has one file, `{video: {frame from 1: {labels}}}` with `ocr` in each label. Texts that
are not legible English are told as `###`.
"""

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.texts.files import Place, brief, read_json
from drivers.datasets.texts.labels import ILLEGIBLE, MOST_LETTERS, MOST_TEXTS
from drivers.datasets.video import VideoFile
from drivers.source import Annotations, FrameSource
from pipeline.errors import DriverError

READABLE = ("English_Legible", "English")
CATEGORIES = (*READABLE, "Non_English_Legible", "Illegible")
MOST_IDS = 2**31 - 1
FRAME = re.compile(r"[0-9]{1,9}")
Rows = dict[int, list[tuple[list[float], int, str]]]  # frame from 0 -> box, id, text


class RoadTextVideo:
    """A `FrameSource` over `path`, an mp4, and `labels`, a JSON file of the data set.

    `transcriptions` is the second file of the original release: id -> text.
    """

    def __init__(self, *, path: str, labels: str, transcriptions: str = "") -> None:
        name = Path(path).stem
        self._rows = read_roadtext(Path(labels), name, transcriptions)
        self._video = VideoFile(path=path)
        self.size_px, self.rate_hz = self._video.size_px, self._video.rate_hz
        self.length = self._video.length
        last = max(self._rows, default=-1)
        if self.length is not None and last >= self.length:
            self.close()
            raise DriverError(
                f"{labels}: {name}: expected frames up to {self.length}, got frame {last + 1}"
            )

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        return self._video.picture(index)

    def truth(self, index: int) -> Annotations:
        """Return the texts of a frame."""
        rows = self._rows.get(index, [])
        return Annotations(
            boxes=np.array([row[0] for row in rows], np.float32).reshape(-1, 4),
            ids=np.array([row[1] for row in rows], np.int32),
            labels=tuple(row[2] for row in rows),
            visibility=np.ones(len(rows), np.float32),
        )

    def close(self) -> None:
        """Release the decoder."""
        self._video.close()


def read_roadtext(path: Path, video: str, transcriptions: str = "") -> Rows:
    """Read the truth of one video; raises `DriverError` with file, line and place."""
    document = read_json(path)
    if isinstance(document, dict):
        if video not in document:
            raise DriverError(f"{path}: expected a video {video}, got {_some(document)}")
        return _challenge(document[video], Place(path) / video)
    if isinstance(document, list):
        said = read_json(Path(transcriptions)) if transcriptions else {}
        if not isinstance(said, dict):
            raise DriverError(f"{transcriptions}: expected id -> text, got {type(said).__name__}")
        return _original(document, said, video, path)
    raise DriverError(f"{path}: expected a list or videos by name, got {type(document).__name__}")


def _challenge(frames: Any, where: Place) -> Rows:
    if not isinstance(frames, dict):
        raise DriverError(f"{where}: expected frames by number, got {type(frames).__name__}")
    found: Rows = {}
    for key, frame in frames.items():
        place = where / key
        if not FRAME.fullmatch(key) or int(key) < 1:
            raise DriverError(f"{place}: expected a frame from 1")
        found[int(key) - 1] = _rows(frame, place, {})
    return found


def _original(document: list[Any], said: Mapping[str, Any], video: str, path: Path) -> Rows:
    found: Rows = {}
    for number, frame in enumerate(document):
        place = Place(path) / number
        if not isinstance(frame, dict) or not isinstance(frame.get("videoName"), str):
            raise DriverError(f"{place}: expected videoName, index and labels")
        if Path(frame["videoName"]).stem != video:
            continue
        index = frame.get("index")
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index <= MOST_IDS:
            raise DriverError(f"{place}: expected an index from 0, got {brief(index)}")
        found[index] = _rows(frame, place, said)
    if not found:
        raise DriverError(f"{path}: expected a video {video}, got none of that name")
    return found


def _rows(frame: Any, place: Place, said: Mapping[str, Any]) -> list[tuple[list[float], int, str]]:
    labels = frame.get("labels") if isinstance(frame, dict) else frame
    if labels is None and isinstance(frame, dict):
        return []
    if not isinstance(labels, list) or len(labels) > MOST_TEXTS:
        raise DriverError(f"{place}: expected labels, a list or null, got {str(labels)[:60]}")
    return [_row(label, place / "labels" / k, said) for k, label in enumerate(labels)]


def _row(label: Any, place: Place, said: Mapping[str, Any]) -> tuple[list[float], int, str]:
    box = label.get("box2d") if isinstance(label, dict) else None
    try:
        sides = [float(box[name]) for name in ("x1", "y1", "x2", "y2")]  # type: ignore[index]
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        expected = "expected box2d with x1, y1, x2, y2"
        raise DriverError(f"{place}: {expected}, got {brief(box)}") from error
    if not np.isfinite(sides).all() or sides[2] < sides[0] or sides[3] < sides[1]:
        raise DriverError(
            f"{place}: expected a box with x2 after x1 and y2 after y1, got {brief(box)}"
        )
    category, id_ = label.get("category"), label.get("id")
    if category not in CATEGORIES:
        known = ", ".join(CATEGORIES)
        raise DriverError(f"{place}: expected category {known}, got {brief(category)}")
    try:
        number = int(id_)
    except (TypeError, ValueError, OverflowError) as error:
        raise DriverError(f"{place}: expected a number as id, got {brief(id_)}") from error
    if not 0 <= number <= MOST_IDS:
        raise DriverError(f"{place}: expected an id of 0 to {MOST_IDS}, got {brief(number)}")
    text = label.get("ocr", said.get(str(id_), ""))
    if not isinstance(text, str) or len(text) > MOST_LETTERS:
        raise DriverError(f"{place}: expected a text of at most {MOST_LETTERS} letters")
    readable = category in READABLE and bool(text.strip())
    return sides, number, text.strip() if readable else ILLEGIBLE


def _some(document: Iterable[str]) -> str:
    names = sorted(document)
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def write_roadtext(source: FrameSource, folder: Path, name: str, frames: int) -> tuple[Path, Path]:
    """Write frames of a source with texts as the challenge has them: NAME.mp4, NAME.json.

    Raises `DriverError` for a source without truth, and where the video cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    video, labels = folder / f"{name}.mp4", folder / f"{name}.json"
    fourcc = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(video), fourcc, source.rate_hz, source.size_px)
    if not writer.isOpened():
        raise DriverError(f"{video}: cannot be written as MPEG-4")
    told: dict[str, Any] = {}
    try:
        for index in range(frames):
            truth = source.truth(index)
            if truth is None:
                raise DriverError(f"{name}: expected a source with the truth of its texts")
            writer.write(cv2.cvtColor(source.picture(index), cv2.COLOR_RGB2BGR))
            told[str(index + 1)] = {"labels": _told(truth) or None}
    finally:
        writer.release()
    labels.write_text(json.dumps({name: told}), encoding="utf-8")
    return video, labels


def _told(truth: Annotations) -> list[dict[str, Any]]:
    """Return labels; the format has no negative ids, so that they continue behind the others."""
    return [
        {
            "box2d": dict(zip(("x1", "y1", "x2", "y2"), map(float, box), strict=True)),
            "category": "Illegible" if text == ILLEGIBLE else "English",
            "id": int(id_) if id_ >= 0 else MOST_IDS + int(id_),
            "ocr": "" if text == ILLEGIBLE else text,
        }
        for box, id_, text in zip(truth.boxes, truth.ids, truth.labels, strict=True)
    ]
