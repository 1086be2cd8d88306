"""Every file of graphs/sources can be laid over a graph and plays the source that it names."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from operators.capture import Capture, CaptureSettings
from pipeline.errors import DriverError, SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.settings import build
from tests.drivers.datasets.test_soccernet import GAME, GT
from tests.drivers.mjpeg_server import MjpegServer
from tests.drivers.sequences import write_pictures, write_sequence
from tests.shared_data import Footage

SOURCES = Path(__file__).resolve().parents[2] / "graphs" / "sources"
RECORDINGS = ("soccernet", "mot", "video", "images")
GRAPH = """
name: eyes
nodes:
  capture:
    operator: operators.capture:Capture
    settings: {options: {scene: "tests.drivers.moving_square:MovingSquare"}}
  small:
    operator: operators.downsample:Downsample
    inputs: {frame: capture.context}
"""


def graph(tmp_path: Path) -> Path:
    path = tmp_path / "eyes.yaml"
    path.write_text(GRAPH)
    return path


def recording(kind: str, folder: Path) -> Path:
    """Write a small recording of that kind; return the path to set."""
    if kind == "images":
        write_pictures(folder, 3)
    elif kind == "video":
        folder /= "film.mp4"
        writer = cv2.VideoWriter(str(folder), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
        for _ in range(3):
            writer.write(np.zeros((48, 64, 3), np.uint8))
        writer.release()
    else:
        gt = GT if kind == "soccernet" else "1,1,10,20,5,6,1,1,0.5\n"
        write_sequence(folder, gt=gt, gameinfo=GAME)
    return folder


def capture_of(path: Path, source: str, *changes: str) -> dict[str, Any]:
    overlay = Overlay(source=SOURCES / f"{source}.yaml", changes=changes)
    return load(path, overlay).node("capture").settings


def first_frame(settings: dict[str, Any]) -> tuple[int, ...]:
    subject = Capture(build(CaptureSettings, settings, "capture"))
    subject.realtime = False
    subject.open()
    try:
        frames = subject.produce()
    finally:
        subject.close()
    assert frames is not None
    geometry = frames["context"].header.geometry
    return geometry.width_px, geometry.height_px, geometry.roi_width_px, geometry.roi_height_px


@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_recording_plays_from_the_path_set_on_the_command_line(kind: str, tmp_path: Path) -> None:
    place = tmp_path / kind
    place.mkdir()
    path = recording(kind, place)

    settings = capture_of(graph(tmp_path), kind, f"capture.path={path}")

    assert first_frame(settings) == (64, 48, 16, 12)


@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_missing_path_is_refused_in_one_sentence(kind: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"options\.path: required by drivers\.\w+:\w+, got no"):
        capture_of(graph(tmp_path), kind)


def test_the_soccer_scene_can_be_laid_over_a_graph_with_a_seed(tmp_path: Path) -> None:
    settings = capture_of(graph(tmp_path), "soccer", "capture.seed=3", "capture.frames=1")

    assert settings["options"]["seed"] == 3
    assert first_frame(settings) == (1920, 1080, 480, 270)


@pytest.mark.footage
def test_the_real_sequence_plays(tmp_path: Path, footage: Footage) -> None:
    folder = footage.data("soccernet/SNMOT-116a")

    settings = capture_of(graph(tmp_path), "soccernet", f"capture.path={folder}")

    assert first_frame(settings) == (1920, 1080, 480, 270)


def test_every_source_file_is_tested() -> None:
    assert {path.stem for path in SOURCES.glob("*.yaml")} >= {*RECORDINGS, "soccer"}


def test_a_stream_plays_from_the_address_set_on_the_command_line(tmp_path: Path) -> None:
    server = MjpegServer()
    change = f"capture.camera_options.url={server.url}"
    found = first_frame(capture_of(graph(tmp_path), "rtsp", change))
    server.stop()

    assert found == (320, 192, 80, 48)


def test_a_webcam_is_named_on_the_command_line(tmp_path: Path) -> None:
    settings = capture_of(graph(tmp_path), "webcam", "capture.camera_options.device=/dev/null")

    with pytest.raises(DriverError, match="/dev/null: expected a video device, got something else"):
        first_frame(settings)


def test_a_stream_without_an_address_is_an_error_of_its_file(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"rtsp\.yaml:\d+: .*url or pipeline: expected exactly one"
    ):
        capture_of(graph(tmp_path), "rtsp")
