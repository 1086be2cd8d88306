"""What a browser shows is what the recording holds."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from bench.gallery import photograph
from bench.headless import browser
from operators.visualise import Visualise
from pipeline import Frame, RunError
from pipeline.testing import drive
from tests.operators.visualise.exposures import exposure
from tests.operators.visualise.test_visualise import rows

Image = pytest.importorskip("PIL.Image")
GREEN, BLUE = (20, 160, 60), (40, 60, 220)  # of the context, of the ROI
NEAR = 40  # of a colour, after JPEG
FRAMES = 3
LIMIT_S = 120.0


def plain(frame: Frame, colour: tuple[int, int, int]) -> Frame:
    """Return the frame in one colour."""
    return replace(frame, pixels=np.full_like(frame.pixels, colour))


@pytest.mark.slow
def test_a_browser_shows_context_and_roi_where_the_recording_has_them(tmp_path: Path) -> None:
    try:
        browser()
    except RunError as error:
        pytest.skip(str(error))
    path = tmp_path / "seen.rrd"
    seen = [next(iter(given.items())) for seq in range(FRAMES) for given in exposure(seq)]
    window = (480, 270, 960, 540)  # a sixteenth of the field
    given = [
        {"context": plain(message, GREEN)} if name == "context"
        else {"roi": replace(plain(message, BLUE), window=window)}
        for name, message in seen if name in ("context", "roi")
    ]  # fmt: skip
    drive(Visualise, given, {"save": str(path)})

    picture = pixels(photograph(path, LIMIT_S, lambda png: near(pixels(png), BLUE).mean() > 0.02))

    chunks = list(RrdReader(path).stream())
    (left, top, _), *_ = rows(chunks, "/sensor/roi", "translation")[-1]
    field = box_of(near(picture, GREEN)[:, : picture.shape[1] * 5 // 8])  # left of the ROI alone
    roi = box_of(near(picture, BLUE)[:, : picture.shape[1] * 5 // 8])
    scale = (field[2] - field[0]) / 1920
    expected = [field[0] + left * scale, field[1] + top * scale, 480 * scale, 270 * scale]
    assert [roi[0], roi[1], roi[2] - roi[0], roi[3] - roi[1]] == pytest.approx(expected, abs=8)
    beside = near(picture, BLUE)[:, picture.shape[1] * 5 // 8 :]
    assert beside.mean() > 0.05  # the ROI on its own, enlarged


def pixels(png: bytes) -> NDArray[np.int_]:
    """Return the pixels of a PNG, (h, w, 3)."""
    return np.asarray(Image.open(BytesIO(png)).convert("RGB"), int)


def near(picture: NDArray[np.int_], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return which pixels (h, w, 3) have about this colour: (h, w)."""
    return np.asarray((np.abs(picture - colour) < NEAR).all(axis=2))


def box_of(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the box around most of the pixels: a label of the same colour does not count."""
    rows_, columns = (np.flatnonzero(mask.mean(axis=axis) > 0.05) for axis in (1, 0))
    return int(columns[0]), int(rows_[0]), int(columns[-1]) + 1, int(rows_[-1]) + 1
