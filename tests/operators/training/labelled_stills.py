"""Folders of labelled stills for tests: drawn people and balls on grass."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

GRASS, KIT, WHITE = (60, 130, 50), (200, 30, 40), (245, 245, 245)  # RGB
SIZE_PX = (960, 540)
Row = tuple[int, float, float, float, float]  # class, centre and size in pixels


def write_still(
    folder: Path, name: str, rows: Sequence[Row], size: tuple[int, int] = SIZE_PX
) -> Path:
    """Draw and label one still; class 0 is a white ball, every other one a person in red."""
    width, height = size
    for part in ("images", "labels"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    picture = np.full((height, width, 3), GRASS, np.uint8)
    for number, x, y, wide, tall in rows:
        centre, axes = (round(x), round(y)), (int(wide * 0.42), int(tall * 0.42))
        cv2.ellipse(picture, centre, axes, 0, 0, 360, WHITE if number == 0 else KIT, -1)
    path = folder / "images" / f"{name}.png"
    cv2.imwrite(str(path), picture[..., ::-1])
    lines = (f"{n} {x / width} {y / height} {w / width} {h / height}" for n, x, y, w, h in rows)
    (folder / "labels" / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return path


def write_names(folder: Path, *names: str) -> None:
    """Name the classes."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "data.yaml").write_text(f"path: .\nnames: [{', '.join(names)}]\n")


def match_of_stills(folder: Path, *names: str) -> Path:
    """A folder with a ball, two players and a referee in each still."""
    write_names(folder, "ball", "goalkeeper", "player", "referee")
    for name in names:
        write_still(
            folder, name,
            [
                (0, 500, 300, 10, 10), (2, 300, 250, 24, 60),
                (1, 700, 260, 24, 56), (3, 480, 200, 24, 52),
            ],
        )  # fmt: skip
    return folder
