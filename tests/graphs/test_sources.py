"""Every file of graphs/sources can be laid over a graph and plays the source that it names."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from operators.capture import Capture, CaptureSettings
from pipeline.errors import DriverError, FoveaError, SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.inline import InlineRunner
from pipeline.settings import build
from tests.drivers.datasets.test_soccernet import GAME, GT
from tests.drivers.mjpeg_server import MjpegServer
from tests.drivers.sequences import write_pictures, write_sequence
from tests.shared_data import Footage

SOURCES = Path(__file__).resolve().parents[2] / "graphs" / "sources"
SQUARE = "tests.drivers.moving_square:MovingSquare"
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


def test_the_whole_pitch_can_be_laid_over_a_graph_from_either_side(tmp_path: Path) -> None:
    options = ("capture.source_options.view=behind_goal", "capture.size_px=[1920, 480]")
    settings = capture_of(graph(tmp_path), "whole_pitch", *options)

    assert settings["options"]["source_options"]["camera"] == "whole"
    assert first_frame(settings) == (1920, 480, 480, 120)


@pytest.mark.footage
def test_the_real_sequence_plays(tmp_path: Path, footage: Footage) -> None:
    folder = footage.data("soccernet/SNMOT-116a")

    settings = capture_of(graph(tmp_path), "soccernet", f"capture.path={folder}")

    assert first_frame(settings) == (1920, 1080, 480, 270)


def test_every_source_file_is_tested() -> None:
    assert {path.stem for path in SOURCES.glob("*.yaml")} >= {
        *RECORDINGS, "photographs", "road", "roadtext", "soccer", "whole_pitch", "raw",
        "usb", "usb_raw",
    }  # fmt: skip


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


def test_a_raw_sensor_runs_in_a_graph_that_knows_rgb_alone(tmp_path: Path) -> None:
    plan = load(graph(tmp_path), Overlay(source=SOURCES / "raw.yaml"))

    sent = {(e.source, e.output): e.target for e in plan.edges}
    assert sent[("capture", "context")] == "context_rgb"
    assert sent[("capture", "roi")] == "roi_rgb"
    assert sent[("context_rgb", "out")] == "small"


def test_the_graph_sees_the_raw_scene_in_its_own_colours(tmp_path: Path) -> None:
    quiet = ("capture.full_well_e=0", "capture.read_noise_e=0")
    shown: dict[str, dict[str, Any]] = {}
    for name, changes in (("raw", quiet), ("soccer", ())):
        few = (f"capture.scene={SQUARE}", "capture.size_px=[640, 352]", "capture.frames=1")
        overlay = Overlay(
            source=SOURCES / f"{name}.yaml", changes=(*few, *changes), clock="lockstep"
        )
        seen = shown[name] = {}
        with InlineRunner(load(graph(tmp_path), overlay), watch=seen.setdefault) as runner:
            list(runner.run())

    raw, plain = shown["raw"], shown["soccer"]
    assert raw["capture.context"].packed
    assert raw["capture.context"].size_px == (160, 88)
    for seen, wanted in (
        ("context_rgb.out", "capture.context"),
        ("roi_rgb.out", "capture.roi"),
    ):
        got, truth = raw[seen].pixels.astype(float), plain[wanted].pixels.astype(float)
        assert raw[seen].window == plain[wanted].window
        assert np.abs(got.mean((0, 1)) - truth.mean((0, 1))).max() < 2


def test_a_raw_board_on_usb_runs_in_a_graph_that_knows_rgb_alone(tmp_path: Path) -> None:
    board = (
        "capture.backend=drivers.virtual_board:VirtualBackend",
        f"capture.backend_options={{scene: '{SQUARE}', size_px: [320, 192], frames: 2}}",
        "capture.rate_hz=100",
    )
    linear = ("context_rgb.gamma=1", "roi_rgb.gamma=1")  # the samples of the virtual board are not
    shown: dict[str, dict[str, Any]] = {}
    for name, changes in (("usb_raw", linear), ("usb", ())):
        overlay = Overlay(
            source=SOURCES / f"{name}.yaml", changes=(*board, *changes), clock="lockstep"
        )
        seen = shown[name] = {}
        with InlineRunner(load(graph(tmp_path), overlay), watch=seen.setdefault) as runner:
            assert list(runner.run()) == [0, 1]

    raw, plain = shown["usb_raw"], shown["usb"]
    assert raw["capture.context"].pixel_format == "bayer_rggb12p"
    assert raw["capture.context"].size_px == plain["capture.context"].size_px
    for seen, wanted in (("context_rgb.out", "capture.context"), ("roi_rgb.out", "capture.roi")):
        got, truth = raw[seen], plain[wanted]
        assert (got.pixel_format, got.window) == ("rgb8", truth.window)
        assert np.abs(got.pixels.mean((0, 1)) - truth.pixels.mean((0, 1))).max() < 4


OVERLAY = """
settings: {options: {scene: "tests.drivers.moving_square:MovingSquare"}}
"""


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (
            "instead: {capture.context: rgb}",
            r"over.yaml:3: source.instead.'capture.context': no node rgb; there is",
        ),
        ("instead: {capture.context: 5}", r"over.yaml:3: .*: expected a node or node.output, got"),
        ("instead: rgb", r"over.yaml:3: source.instead: expected a mapping, got str"),
        ("nodes: [1]", r"over.yaml:3: source.nodes: expected a mapping, got list"),
        ("nodes: {rgb: 5}", r"over.yaml:3: nodes.rgb: expected a mapping, got int"),
        ("nodes: {small: {operator: a:B}}", r"over.yaml:3: source.nodes.small: .* of that name"),
        ("through: {}", r"over.yaml:3: source.through: no such key"),
        (
            "nodes: {rgb: {operator: operators.downsample:Downsample, inputs: {frame: captur}}}",
            r"over.yaml:3: rgb.inputs.frame: no node captur, did you mean",
        ),
        ("instead: {capture.context: small}", r"eyes.yaml:\d+: .*small"),
    ],
)
def test_what_a_source_file_adds_wrongly_is_refused_with_its_line(
    more: str, named: str, tmp_path: Path
) -> None:
    over = tmp_path / "over.yaml"
    over.write_text(OVERLAY.lstrip() + f"# a comment\n{more}\n")

    with pytest.raises(FoveaError, match=named):
        load(graph(tmp_path), Overlay(source=over))


def test_long_edges_are_led_elsewhere_too_and_others_stay(tmp_path: Path) -> None:
    path = graph(tmp_path)
    long = "{from: capture.context, keep: every}"
    path.write_text(GRAPH.replace("{frame: capture.context}", f"{{frame: {long}}}"))
    over = tmp_path / "over.yaml"
    over.write_text(
        OVERLAY
        + "nodes:\n  rgb: {operator: operators.downsample:Downsample, "
        + "inputs: {frame: capture.context}}\ninstead: {capture.context: rgb}\n"
    )

    plan = load(path, Overlay(source=over))

    edges = {e.target: (e.source, e.keep) for e in plan.edges}
    assert edges == {"small": ("rgb", "every"), "rgb": ("capture", "latest")}


def test_a_road_without_labels_is_an_error_of_its_file(tmp_path: Path) -> None:
    said = r"roadtext\.yaml:\d+: capture\.options\.source_options\.labels: required by drivers\."

    with pytest.raises(SettingsError, match=said):
        capture_of(graph(tmp_path), "roadtext", "capture.path=film.mp4")
