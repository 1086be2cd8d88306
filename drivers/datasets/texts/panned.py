"""A virtual camera over labelled photographs: a folder in, a video with the truth of its texts out.

Each photograph is shown for some frames, while the camera comes nearer and moves aside. At its
nearest a pixel of the picture is one of the photograph, so that nothing is enlarged.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.images import SUFFIXES
from drivers.datasets.pictures import read_picture
from drivers.datasets.texts.labels import ILLEGIBLE, Label, labels_beside, read_textocr
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

Image = NDArray[np.uint8]

FARTHEST = 0.55  # pixels of the picture per pixel of the photograph, when a clip begins
ASIDE = 0.15  # of the picture's sides, by which the camera moves
LEAST_LEGIBLE_PX = 8.0  # height of a text; the photographs' own labels say what is illegible
LEAST_SEEN = 0.9
ROOM = 10_000  # ids of one photograph


class PannedPictures:
    """A `FrameSource`: `frames_each` frames of each labelled photograph, in order of name.

    `path` is a folder or one photograph.

    The labels are files beside the photographs (ICDAR, labelme, Total-Text), or one of TextOCR,
    named by `labels`. Photographs without labels are left out. All pictures have the size of the
    first photograph, or `size_px`.
    """

    def __init__(
        self, *, path: str, labels: str = "", frames_each: int = 30, rate_hz: float = 10.0,
        seed: int = 0, size_px: tuple[int, int] = (0, 0),
    ) -> None:  # fmt: skip
        if frames_each < 1 or seed < 0 or not 0.01 <= rate_hz <= 1000:
            raise SettingsError(
                "frames_each, seed, rate_hz: expected at least 1, at least 0 and 0.01 to 1000, got "
                f"{frames_each}, {seed} and {rate_hz:g}"
            )
        folder = Path(path)
        if not folder.exists():
            raise DriverError(f"{folder}: expected photographs, got no such folder or file")
        among = folder.rglob("*") if folder.is_dir() else [folder]
        files = sorted(f for f in among if f.suffix.lower() in SUFFIXES)
        self._clips = _labelled(files, labels)
        if not self._clips:
            raise DriverError(
                f"{folder}: expected photographs with labels (gt_NAME.txt, NAME.json, "
                f"poly_gt_NAME.txt, or labels=FILE of TextOCR), got {len(files)} without"
            )
        self.rate_hz, self._frames_each, self._seed = rate_hz, frames_each, seed
        self.length: int | None = frames_each * len(self._clips)
        self._opened = -1, np.zeros((0, 0, 3), np.uint8)
        first = self._photograph(0)
        self.size_px = (first.shape[1], first.shape[0]) if not any(size_px) else size_px
        if not all(16 <= side <= 16384 for side in self.size_px):
            raise SettingsError(f"size_px: expected sides of 16 to 16384, got {self.size_px}")
        self._buffer = np.empty((self.size_px[1], self.size_px[0], 3), np.uint8)

    def picture(self, index: int) -> Image:
        """Draw frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        clip, matrix = self._camera(index)
        flags = cv2.INTER_AREA if matrix[0, 0] < 0.6 else cv2.INTER_LINEAR
        photograph = self._photograph(clip)
        cv2.warpAffine(
            photograph, matrix, self.size_px, dst=self._buffer, flags=flags,
            borderMode=cv2.BORDER_REFLECT_101,
        )  # fmt: skip
        return self._buffer

    def truth(self, index: int) -> Annotations:
        """Return boxes, transcriptions and visible shares of the texts in the picture.

        The label is `###` where the data set says so, and where a text is small or cut off.
        """
        clip, matrix = self._camera(index)
        field = np.array([*self.size_px, *self.size_px], np.float32)
        rows = []
        for number, label in enumerate(self._clips[clip][1]):
            outline = label.outline @ matrix[:, :2].T + matrix[:, 2]
            whole = np.concatenate([outline.min(0), outline.max(0)])
            box = np.clip(whole, 0, field)
            area = np.prod(np.maximum(whole[2:] - whole[:2], 1e-3))
            seen = float(np.prod(np.maximum(box[2:] - box[:2], 0)) / area)
            if seen <= 0:
                continue
            clear = seen >= LEAST_SEEN and height_of(outline) >= LEAST_LEGIBLE_PX
            rows.append((box, clip * ROOM + number, label.text if clear else ILLEGIBLE, seen))
        return Annotations(
            boxes=np.array([row[0] for row in rows], np.float32).reshape(-1, 4),
            ids=np.array([row[1] for row in rows], np.int32),
            labels=tuple(row[2] for row in rows),
            visibility=np.array([row[3] for row in rows], np.float32),
        )

    def close(self) -> None:
        """Do nothing: no file is open between pictures."""

    def _camera(self, index: int) -> tuple[int, NDArray[np.float64]]:
        """Return the photograph of a frame and the map (2, 3) from it to the picture."""
        if not 0 <= index < (self.length or 0):
            raise IndexError(f"no frame {index} in {self.length}")
        clip, step = divmod(index, self._frames_each)
        rng = np.random.default_rng([self._seed, clip])
        high, wide = self._photograph(clip).shape[:2]
        share = step / max(1, self._frames_each - 1)
        scale = FARTHEST + (1 - FARTHEST) * share
        begin, end = rng.uniform(-ASIDE, ASIDE, (2, 2))
        aside = (begin + (end - begin) * share) * self.size_px
        shift = np.array(self.size_px) / 2 + aside - scale * np.array([wide, high]) / 2
        return clip, np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])

    def _photograph(self, clip: int) -> Image:
        if self._opened[0] != clip:
            self._opened = clip, read_picture(self._clips[clip][0])
        return self._opened[1]


def _labelled(files: list[Path], labels: str) -> list[tuple[Path, list[Label]]]:
    """Return the photographs that have labels."""
    if labels:
        known = read_textocr(Path(labels))
        return [(file, known[file.name]) for file in files if known.get(file.name)]
    found = ((file, labels_beside(file)) for file in files)
    return [(file, own) for file, own in found if own]


def height_of(outline: NDArray[np.floating]) -> float:
    """Return the smaller side of the smallest rectangle around a text, pixels."""
    (_, size, _) = cv2.minAreaRect(np.asarray(outline, np.float32))
    return float(min(size))
