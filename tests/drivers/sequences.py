"""Write small sequence folders in the formats of MOT and SoccerNet, for tests."""

from pathlib import Path

import cv2
import numpy as np

SIZE_PX = (64, 48)


def write_pictures(folder: Path, count: int, *, suffix: str = ".jpg", seed: int = 0) -> None:
    """Write plain pictures 000001, 000002, … with different means."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    tint = rng.integers(0, 60, 3)
    for number in range(1, count + 1):
        picture = np.full((SIZE_PX[1], SIZE_PX[0], 3), tint + number * 10, np.uint8)
        cv2.imwrite(str(folder / f"{number:06d}{suffix}"), picture)


def write_sequence(
    folder: Path,
    *,
    gt: str | None = None,
    gameinfo: str | None = None,
    frames: int = 3,
    info: str = "",
) -> Path:
    """Write a sequence folder with `frames` pictures; `info` replaces seqinfo.ini."""
    write_pictures(folder / "img1", frames)
    (folder / "seqinfo.ini").write_text(
        info
        or f"[Sequence]\nname=made-up\nimDir=img1\nframeRate=25\nseqLength={frames}\n"
        f"imWidth={SIZE_PX[0]}\nimHeight={SIZE_PX[1]}\nimExt=.jpg\n"
    )
    if gt is not None:
        (folder / "gt").mkdir(exist_ok=True)
        (folder / "gt" / "gt.txt").write_text(gt)
    if gameinfo is not None:
        (folder / "gameinfo.ini").write_text(gameinfo)
    return folder
