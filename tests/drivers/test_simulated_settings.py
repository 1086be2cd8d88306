"""Settings and modes of the simulated sensor: what it takes, and what it refuses."""

from typing import Any

import pytest

from drivers.sensor import Mode
from drivers.simulated import SimulatedSensorSettings
from drivers.simulated.sources import open_recording, open_scene
from drivers.virtual_board.backend import VirtualBoardSettings
from pipeline.errors import SettingsError
from pipeline.settings import build
from tests.drivers.contract import read
from tests.drivers.test_simulated import HERE, sensor


def test_configure_changes_pixel_format_and_rate() -> None:
    subject = sensor()
    subject.open(realtime=False)
    subject.configure(Mode(pixel_format="bayer_rggb8", rate_hz=50))
    subject.start()
    frames = [read(subject) for _ in range(2)]
    subject.close()

    assert frames[0].context.pixel_format == "bayer_rggb8"
    assert frames[0].context.pixels.ndim == 2


@pytest.mark.parametrize(
    ("mode", "named"),
    [
        (Mode(roi_px=(1, 1)), r"roi_px: expected one of \(\(80, 48\),\), got \(1, 1\)"),
        (Mode(pixel_format="yuv"), "pixel_format: expected rgb8, bayer_rggb8, .*, got yuv"),
        (Mode(rate_hz=1e9), "rate_hz: expected 0.01 to 10000, got"),
    ],
)
def test_configure_refuses_unsupported_modes(mode: Mode, named: str) -> None:
    subject = sensor()
    subject.open(realtime=False)

    with pytest.raises(SettingsError, match=named):
        subject.configure(mode)
    subject.close()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"scene": ""}, "scene or source: expected exactly one"),
        ({"source": f"{HERE}:MovingSquare"}, "scene or source: expected exactly one"),
        ({"scene": "socker"}, "scene: expected soccer, panorama, road, insertion or an import"),
        ({"context_scale": 0.0}, "context_scale: expected above 0 to 1, got 0.0"),
        ({"budget": 2.0}, "budget: expected above 0 to 1"),
        ({"noise": float("nan")}, "noise: must be at least 0"),
        ({"step_px": -1}, "step_px: must be at least 0"),
        ({"step_px": 3, "mosaic": True}, "step_px: a mosaic needs an even step, got 3"),
        ({"rate_hz": 1e6}, "rate_hz: expected 0.01 to 10000"),
        ({"size_px": (1, 1)}, "size_px: expected sides of 16 to 32768"),
        ({"strategy": "guess"}, "strategy: expected foveated, "),
        ({"strategy": "temporal", "budget": 0.3}, "budget: temporal needs 1 over a whole number"),
        (
            {"roi_area": 0.25},
            "budget: context 0.0625 and ROI 0.25 take 0.3125 of the field, expected at most 0.125",
        ),
        (
            {"scene": "", "source": "drivers.datasets:SoccerNetSequence"},
            "path: required by drivers.datasets:SoccerNetSequence, got nothing",
        ),
        (
            {
                "scene": "",
                "source": "drivers.datasets:MotSequence",
                "path": "x",
                "source_options": {"n": 1},
            },
            "source: drivers.datasets:MotSequence takes path, got n",
        ),
        ({"scene": "", "source": "nowhere:Nothing"}, "source: nowhere:Nothing cannot be imported"),
        (
            {"scene": "", "source": "pathlib:Path"},
            "source: expected a FrameSource, got pathlib:Path",
        ),
    ],
)
def test_wrong_settings_are_refused_in_one_sentence(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        sensor(**settings)


def test_a_wrong_type_from_yaml_is_refused_with_its_place() -> None:
    with pytest.raises(SettingsError, match=r"options\.size_px"):
        build(SimulatedSensorSettings, {"scene": "soccer", "size_px": "big"}, "options")


@pytest.mark.parametrize(
    ("scene", "options", "named"),
    [
        ("panorama", {"objects": "x"}, "objects: input should be a valid integer, got 'x'"),
        ("panorama", {"person_share": None}, "person_share: input should be a valid number"),
        ("soccer", {"difficulty": float("nan")}, "difficulty: expected a finite number, got nan"),
        (f"{HERE}:MovingSquare", {"size_px": [320]}, "size_px"),
    ],
)
def test_options_of_a_wrong_type_are_refused_in_one_sentence(
    scene: str, options: dict[str, Any], named: str
) -> None:
    with pytest.raises(SettingsError, match=named):
        open_scene(scene, size_px=(0, 0), rate_hz=0, seed=0, length=None, options=options)


def test_an_option_that_yaml_has_as_a_list_comes_as_its_type() -> None:
    options = {"size_px": [320, 192], "rate_hz": 50}

    source = open_recording(f"{HERE}:MovingSquare", path="", options=options)

    assert (source.size_px, source.rate_hz) == ((320, 192), 50)
    source.close()


@pytest.mark.parametrize(
    ("name", "value"), [("noise", float("nan")), ("noise", -1.0), ("frames", -1), ("seed", -1)]
)
def test_a_virtual_board_refuses_what_no_sensor_has(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name}: must be at least 0, got"):
        VirtualBoardSettings(scene="soccer", **{name: value})  # type: ignore[arg-type]
