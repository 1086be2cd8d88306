"""A SoccerNet Tracking sequence: its folder in, pictures and truth by role out.

The class of a track is in gameinfo.ini, not in gt.txt: `trackletID_7= player team right;34`.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.sequence import (
    MOST_INI_BYTES,
    NumberedPictures,
    Row,
    by_frame,
    no_objects,
    read_info,
    read_ini,
    read_rows,
)
from drivers.regular_file import read_text
from drivers.source import Annotations
from pipeline.errors import DriverError, SettingsError

_KEY = re.compile(r"trackletID_(\d+)")
_REFEREES = {"main": "main referee", "side": "assistant referee"}


@dataclass(frozen=True, kw_only=True)
class Tracklet:
    """The role, team and shirt number of a track."""

    label: str  # ball, player, goalkeeper, main referee, assistant referee
    team: str  # left, right, or empty
    mark: str  # shirt number, or a letter where it was never read


class SoccerNetSequence:
    """A `FrameSource` over `<folder>/{seqinfo.ini, gameinfo.ini, img1/, gt/gt.txt}`.

    `tracklets` gives the role of each id. A sequence without gt/gt.txt has no truth. It begins with
    its frame `first`, from 0 on.
    """

    shows = "soccer"

    def __init__(self, *, path: str, first: int = 0) -> None:
        folder = Path(path)
        info = read_info(folder)
        if not 0 <= first < info.length:
            what = f"expected one of its {info.length} frames, from 0 on, got {first}"
            raise SettingsError(f"first: {what}")
        self._first = first
        self.size_px, self.rate_hz = info.size_px, info.rate_hz
        self.length: int | None = info.length - first
        self._pictures = NumberedPictures(info)
        self.tracklets = read_tracklets(folder / "gameinfo.ini")
        self._truth = _read_truth(folder / "gt" / "gt.txt", self.tracklets)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        return self._pictures.picture(self._first + index)

    def truth(self, index: int) -> Annotations | None:
        """Return the boxes in frame `index`; their visibility is unknown and set to 1."""
        return None if self._truth is None else self._truth.get(self._first + index, no_objects())

    def close(self) -> None:
        """Do nothing: no file is open between pictures."""


def read_tracklets(path: Path) -> dict[int, Tracklet]:
    """Return the role of each track; raises `DriverError` naming file and line of a wrong role."""
    found = {}
    for key, value in read_ini(path).items():
        if match := _KEY.fullmatch(key):
            try:
                found[int(match[1])] = parse_role(value)
            except ValueError as error:
                raise DriverError(f"{path}:{_line_of(path, key)}: {key}: {error}") from error
    return found


def parse_role(text: str) -> Tracklet:
    """Parse `<role>;<label>` of gameinfo.ini; raises ValueError for an unknown role.

    >>> parse_role("goalkeepers team left;1")
    Tracklet(label='goalkeeper', team='left', mark='1')
    >>> parse_role("referee;side bottom").label
    'assistant referee'
    """
    role, _, mark = (part.strip() for part in text.partition(";"))
    words = role.lower().split()
    team = words[-1] if words[-1:] in (["left"], ["right"]) else ""
    first, place = (words or [""])[0], mark.lower().split()[:1]
    if first in ("player", "players", "goalkeeper", "goalkeepers") and team:
        return Tracklet(label=first.removesuffix("s"), team=team, mark=mark)
    if first == "ball":
        return Tracklet(label="ball", team="", mark=mark)
    if first == "referee" and place and place[0] in _REFEREES:
        return Tracklet(label=_REFEREES[place[0]], team="", mark=mark)
    raise ValueError(
        "expected player team, goalkeepers team (left or right), referee;main, referee;side … or "
        f"ball, got {text!r}"
    )


def _read_truth(path: Path, tracklets: dict[int, Tracklet]) -> dict[int, Annotations] | None:
    if not path.is_file():
        return None
    rows: list[Row] = list(read_rows(path, columns=6))
    for row in rows:
        if row.id not in tracklets:
            raise DriverError(
                f"{path}:{row.line}: expected a tracklet that gameinfo.ini names, got {row.id}"
            )
    return by_frame(rows, [tracklets[r.id].label for r in rows], [1.0] * len(rows))


def _line_of(path: Path, key: str) -> int:
    lines = read_text(path, MOST_INI_BYTES, "utf-8-sig").split("\n")
    return next(n for n, line in enumerate(lines, 1) if line.partition("=")[0].strip() == key)
