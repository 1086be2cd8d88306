"""The source files of industrial cameras lay over a graph."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from pipeline.errors import SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"


def options_of(source: str, *changes: str) -> dict[str, object]:
    overlay = Overlay(source=GRAPHS / "sources" / f"{source}.yaml", changes=changes)
    found: dict[str, object] = (
        load(GRAPHS / "tracking.yaml", overlay).node("capture").settings["options"]
    )
    return found


def test_a_foveating_camera_is_named_on_the_command_line() -> None:
    found = options_of(
        "genicam_foveated", "capture.camera=S7", "capture.features={ExposureTime: 5000, Gain: 3}"
    )

    assert (found["camera"], found["binning"]) == ("S7", 4)
    assert found["features"] == {"ExposureTime": 5000, "Gain": 3}


@pytest.mark.skipif(not find_spec("drivers.cameras"), reason="no drivers.cameras")
def test_a_plain_camera_is_named_on_the_command_line() -> None:
    found = options_of("genicam", "capture.camera_options.camera=S7")

    assert found["camera"] == "drivers.genicam:GenicamCamera"
    assert found["camera_options"] == {
        "camera": "S7", "pixel_format": "", "rate_hz": 0, "features": {}
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("capture.binning=1", "binning: expected 0 or 2 to 32, got 1"),
        ("capture.pixel_format=RGB9", "pixel_format: expected one of RGB8, BGR8"),
        ("capture.rate_hz=-1", "rate_hz: expected 0 to 1"),
        ("capture.absent_s=0", "absent_s: expected above 0 to 86400"),
        ("capture.buffers=1", "buffers: expected 2 to 256, got 1"),
        ("capture.features={Gain: [1]}", "features.Gain"),
        ("capture.packet_bytes=9", "packet_bytes: expected 576 to 16000"),
        ("capture.answer_s=0", "answer_s: expected 0.01 to 60"),
    ],
)
def test_a_wrong_setting_is_refused_before_the_camera_is_opened(change: str, sentence: str) -> None:
    with pytest.raises(SettingsError) as caught:
        options_of("genicam_foveated", change)

    assert sentence in str(caught.value)
