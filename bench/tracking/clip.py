"""A clip in memory: a folder or a seed -> its pictures at full resolution and the truth of each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.datasets.sequence import read_info
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes import WholePitchScene
from drivers.scenes.panorama import PanoramaScene
from drivers.scenes.soccer import SoccerScene
from drivers.simulated.windows import Picture, picture_of
from drivers.source import Annotations, FrameSource
from pipeline.errors import DriverError, SettingsError

DEVELOPMENT = ("SNMOT-116a",)  # looked at while rules, thresholds and scenes were chosen
HELD_OUT = 70_000  # first seed of the clips that nothing is trained or chosen on
PROCEDURAL, PANORAMA, WHOLE_PITCH = "procedural", "panorama", "whole_pitch"
SIZES_PX = {PROCEDURAL: (1920, 1080), PANORAMA: (16_320, 9_184), WHOLE_PITCH: (7680, 4320)}
RATE_HZ = 25.0
KEPT_FRAMES = 400  # of the whole pitch, with what moves in them: about 1 MB each


@dataclass(frozen=True, kw_only=True)
class ClipName:
    """Where a clip comes from: a seed of a scene, or a SoccerNet sequence's folder."""

    seed: int = -1
    folder: str = ""
    scene: str = PROCEDURAL  # of a seed

    def __str__(self) -> str:
        # resolved, because `.` has no name
        return Path(self.folder).resolve().name if self.folder else f"{self.scene}-{self.seed}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    """F frames; whole pictures of 1080p take 6 MB each, those read by windows nothing."""

    name: ClipName
    size_px: tuple[int, int]
    pictures: Sequence[Picture]  # F of (h, w, 3) RGB, or to be read by windows
    truths: Sequence[Annotations]
    source: FrameSource | None = None  # open, if pictures are read by windows

    @property
    def windowed(self) -> bool:
        """Whether pictures are made only where they are looked at."""
        return self.source is not None

    def close(self) -> None:
        """Release the source."""
        if self.source is not None:
            self.source.close()


def names(data: str, count: int) -> list[ClipName]:
    """Return the clips of `--data`.

    It is `procedural`, `panorama` or `whole_pitch`, each with `:FIRST` if wanted, a sequence's
    folder, or a folder of such folders; raises `SettingsError` or `DriverError` for anything else.
    """
    scene, colon, first = data.partition(":")
    if scene in SIZES_PX and (colon or not Path(data).is_dir()):
        if colon and not first.isdigit():
            raise SettingsError(f"data: expected {scene}:SEED, got {data!r}")
        start = int(first) if first else HELD_OUT
        return [ClipName(seed=start + k, scene=scene) for k in range(count)]
    folder = Path(data)
    if not folder.is_dir():
        raise DriverError(f"{folder}: expected a folder of SoccerNet sequences, found none")
    found = [folder] if (folder / "seqinfo.ini").exists() else sorted(folder.iterdir())
    found = [f for f in found if (f / "seqinfo.ini").exists()]
    if not found:
        raise DriverError(f"{folder}: expected seqinfo.ini in it or in its folders, found none")
    for each in found:
        if SoccerNetSequence(path=str(each)).truth(0) is None:
            raise DriverError(
                f"{each}: expected gt/gt.txt, found none: there is no truth to score by"
            )
    return [ClipName(folder=str(each)) for each in found]


def size_of(name: ClipName) -> tuple[int, int]:
    """Return width and height of a clip's pictures."""
    return read_info(Path(name.folder)).size_px if name.folder else SIZES_PX[name.scene]


def is_development(name: ClipName) -> bool:
    """Whether somebody looked at a clip while choosing what is measured on it."""
    return str(name) in DEVELOPMENT


def frames_of(name: ClipName, frames: tuple[int, int]) -> range:
    """Return indices of frames A-B of a clip, counted from 1 as in SoccerNet's files.

    B 0 means the end of the clip; a scene is endless and needs another B. Raises `SettingsError`
    for frames that the clip does not have.
    """
    length = SoccerNetSequence(path=name.folder).length if name.folder else None
    first, last = frames[0], frames[1] or length or 0
    if not 1 <= first < last or (length is not None and last > length):
        raise SettingsError(
            f"frames: {name} has 1 to {length or 'any'}, got {frames[0]}-{frames[1]}"
        )
    return range(first - 1, last)


def read(name: ClipName, frames: tuple[int, int]) -> Clip:
    """Read frames A-B of a clip, as `frames_of` takes them."""
    indices = frames_of(name, frames)
    source = _source(name)
    pictures: list[Picture] = []
    truths = []
    kept = False
    try:
        for index in indices:
            truth = source.truth(index)
            if truth is None:
                raise DriverError(f"{name}: frame {index + 1} has no truth to score by")
            truths.append(truth)
            picture = picture_of(source, index)
            whole = isinstance(picture, np.ndarray)
            pictures.append(np.array(picture) if whole else picture)
        kept = not whole
    finally:
        if not kept:
            source.close()
    opened = source if kept else None
    return Clip(name=name, size_px=source.size_px, pictures=pictures, truths=truths, source=opened)


def _source(name: ClipName) -> FrameSource:
    if name.folder:
        return SoccerNetSequence(path=name.folder)
    size_px = SIZES_PX[name.scene]
    if name.scene == PANORAMA:
        return PanoramaScene(size_px=size_px, rate_hz=RATE_HZ, seed=name.seed)
    if name.scene == WHOLE_PITCH:
        return WholePitchScene(
            size_px=size_px, rate_hz=RATE_HZ, seed=name.seed, kept_frames=KEPT_FRAMES
        )
    return SoccerScene(size_px=size_px, rate_hz=RATE_HZ, seed=name.seed)
