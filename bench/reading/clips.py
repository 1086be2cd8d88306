"""Clips to read: the name of a scene, or a folder -> clips, each with what the sensor shows.

A folder holds videos (RoadText-1K), each with a JSON file of the same name or beside one file for
all, or labelled photographs (ICDAR, Total-Text, labelme, or TextOCR with its one file), over each
of which a camera pans.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from drivers.datasets.images import SUFFIXES
from drivers.datasets.texts.labels import labels_beside, labels_file, read_textocr
from pipeline.errors import DriverError, SettingsError
from pipeline.fleet.placement import file_digest

ROAD = "road"
MOST_FILES = 100_000


@dataclass(frozen=True, kw_only=True)
class Clip:
    """One clip."""

    name: str
    changes: tuple[str, ...]  # of the graph, as `--set` takes them
    alike: tuple[str, ...]  # those of one clip for all of the data, which name the kept results
    files: tuple[Path, ...] = ()  # picture or video, and labels

    def content(self, digest_of: Callable[[Path], str] = file_digest) -> str:
        """Return what tells the clip from one with other pictures, labels or changes.

        Raises `DriverError` for a file that cannot be read.
        """
        try:
            known = [digest_of(file) for file in self.files]
        except OSError as error:
            raise DriverError(f"{error.filename}: cannot be read: {error.strerror}") from error
        return sha256(json.dumps([self.name, self.changes, known]).encode()).hexdigest()


def clips_of(
    data: str, *, count: int, frames: int, seed: int, labels: str = "", transcriptions: str = ""
) -> list[Clip]:
    """Return the clips, in order of seed or name.

    `labels` is one file for all of a folder, `transcriptions` the second file of RoadText-1K's
    original release. Raises `SettingsError` for such a file of another kind of clip, `DriverError`
    for a folder without any clip.
    """
    for name, path in (("labels", labels), ("transcriptions", transcriptions)):
        if path and (data == ROAD or not Path(path).is_file()):
            where = "a file beside --data FOLDER" if data == ROAD else "a JSON file"
            raise SettingsError(f"{name}: expected {where}, got {path}")
    if data == ROAD:
        return [
            Clip(name=str(each), changes=_street(each), alike=_street(0))
            for each in range(seed, seed + count)
        ]
    folder = Path(data)
    if not folder.is_dir():
        raise DriverError(f"data: expected {ROAD} or a folder, got {data}")
    files = sorted(folder.iterdir())[:MOST_FILES]
    found = _videos(files, labels, transcriptions)
    found |= _photographs(files, frames, "" if found else labels)
    if not found:
        raise DriverError(
            f"{folder}: expected videos with NAME.json or one JSON file, or photographs with "
            f"labels, got neither among {len(files)} files"
        )
    first = next(iter(found.values())).changes
    return [replace(clip, alike=first) for clip in list(found.values())[:count]]


def _street(seed: int) -> tuple[str, ...]:
    return (f"capture.seed={seed}",)


def _videos(files: list[Path], labels: str, transcriptions: str) -> dict[str, Clip]:
    tables = [file for file in files if file.suffix == ".json"]
    found = {}
    for file in files:
        own = file.with_suffix(".json")
        beside = own if own in tables else tables[0] if len(tables) == 1 else ""
        if file.suffix == ".mp4" and (given := labels or str(beside)):
            options: dict[str, object] = {"labels": given}
            read = [file, Path(given)]
            if transcriptions:
                options["transcriptions"] = transcriptions
                read.append(Path(transcriptions))
            found[file.name] = _recorded(read, "RoadTextVideo", options)
    return found


def _photographs(files: list[Path], frames: int, labels: str) -> dict[str, Clip]:
    shown = [(n, file) for n, file in enumerate(files) if file.suffix.lower() in SUFFIXES]
    known = read_textocr(Path(labels)) if labels and shown else {}
    found = {}
    for number, file in shown:
        options: dict[str, object] = {"frames_each": frames, "seed": number}
        if known.get(file.name) if labels else labels_beside(file):
            options |= {"labels": labels} if labels else {}
            beside = Path(labels) if labels else labels_file(file)
            read = [file, *([beside] if beside else [])]
            found[file.name] = _recorded(read, "PannedPictures", options)
    return found


def _recorded(files: list[Path], source: str, options: dict[str, object]) -> Clip:
    """Return the clip of a picture or video, the first of its files."""
    given = {
        "scene": "", "source": f"drivers.datasets:{source}", "path": str(files[0]),
        "source_options": json.dumps(options), "size_px": "[0, 0]", "rate_hz": 0,
    }  # fmt: skip
    changes = tuple(f"capture.{name}={value}" for name, value in given.items())
    return Clip(name=files[0].name, changes=changes, alike=(), files=tuple(files))
