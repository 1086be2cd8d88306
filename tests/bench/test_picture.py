"""The picture in the README: the panels of one frame, drawn by a command."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from bench.picture import HEIGHT_PX, draw, main
from pipeline.errors import RunError
from pipeline.messages import Frame
from pipeline.testing import header
from tests.conftest import ROOT


def frame(height_px: int, width_px: int, window: tuple[int, int, int, int], value: int) -> Frame:
    pixels = np.full((height_px, width_px, 3), value, np.uint8)
    return Frame(header=header(1), pixels=pixels, window=window)


def test_the_window_is_shown_by_the_context_and_by_the_roi() -> None:
    context = frame(270, 480, (0, 0, 1920, 1080), 60)
    context.pixels[135:, 240:] = 90  # the quarter of the field that the ROI shows
    roi = frame(540, 960, (960, 540, 1920, 1080), 200)

    picture = draw({"capture.context": context, "capture.roi": roi})

    assert picture.shape == (HEIGHT_PX, HEIGHT_PX * 8 // 3, 3)
    assert (picture[HEIGHT_PX // 2 - 9, -9] == 90).all()
    assert (picture[-9, -9] == 200).all()


def test_a_graph_without_two_streams_is_refused() -> None:
    with pytest.raises(RunError, match=r"expected frames of capture\.context and capture\.roi"):
        draw({})


def test_the_command_draws_the_tracking_graph(tmp_path: Path) -> None:
    out = tmp_path / "picture.png"

    result = CliRunner().invoke(
        main, [str(ROOT / "graphs" / "tracking.yaml"), "--frames", "3", "--out", str(out)]
    )

    assert result.exit_code == 0, result.output
    assert cv2.imread(str(out)).shape == (HEIGHT_PX, HEIGHT_PX * 8 // 3, 3)
