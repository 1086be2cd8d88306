"""The graph that follows any class by name, over a detector whose answers are known."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from operators.saliency.detector import Detector
from operators.saliency.saliency import SaliencySettings
from pipeline.boxes import centres, covered
from pipeline.cli import commands
from pipeline.cli.running import advice
from pipeline.errors import SettingsError, WeightsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.inline import InlineRunner
from tests.operators.networks import constant_network
from tests.shared_data import Footage

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"
GRAPH = GRAPHS / "follow.yaml"
SIZE_PX = (640, 480)
PERSON, DOG = [400.0, 60.0, 480.0, 220.0], [80.0, 340.0, 180.0, 420.0]  # sensor pixels


@pytest.fixture(autouse=True)
def bare_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """A grey video of 20 frames."""
    path = tmp_path / "film.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, SIZE_PX)
    for _ in range(20):
        writer.write(np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8))
    writer.release()
    return path


@pytest.fixture
def weights(tmp_path: Path) -> str:
    """A detector that sees the same person and the same dog in every picture."""
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0] = [*(value / 4 for value in PERSON), 0.9, 0]
    rows[0, 1] = [*(value / 4 for value in DOG), 0.7, 1]
    path = constant_network(tmp_path / "pets.onnx", rows, size_px=(160, 120))
    (tmp_path / "pets.yaml").write_text("names: [person, dog]\ntrained_on: nothing\n")
    return path


def overlay(film: Path, *changes: str) -> Overlay:
    return Overlay(
        source=GRAPHS / "sources" / "video.yaml",
        changes=(f"capture.path={film}", *changes),
        clock="lockstep",
    )


def looked_at(changes: Overlay, frames: int, live: tuple[int, str] = (-1, "")) -> list[Any]:
    """What capture.roi showed; `live`: a frame, and the class asked for from then on."""
    heard: dict[str, Any] = {}
    windows = []
    with InlineRunner(load(GRAPH, changes), watch=lambda n, m: heard.update({n: m})) as runner:
        for seq in runner.run(frames):
            windows.append(np.array(heard["capture.roi"].window, np.float32))
            if seq == live[0]:
                runner.change("policy", {"target": live[1]})
    return windows


@pytest.mark.parametrize(("target", "box"), [("person", PERSON), ("dog", DOG)])
def test_the_roi_shows_the_class_asked_for(
    film: Path, weights: str, target: str, box: list[float]
) -> None:
    changes = overlay(film, f"saliency.weights={weights}", f"policy.target={target}")

    windows = looked_at(changes, 8)

    assert np.abs(centres(windows[-1]) - centres(np.array(box, np.float32))).max() < 4
    assert covered(np.array([box], np.float32), windows[-1])[0] > 0.7


def test_another_class_is_followed_from_the_moment_it_is_asked_for(
    film: Path, weights: str
) -> None:
    changes = overlay(film, f"saliency.weights={weights}", "policy.target=person")

    windows = looked_at(changes, 12, live=(7, "dog"))

    assert np.abs(centres(windows[7]) - centres(np.array(PERSON, np.float32))).max() < 4
    assert np.abs(centres(windows[-1]) - centres(np.array(DOG, np.float32))).max() < 4


def test_a_general_detector_has_nothing_to_warn_of_in_any_video(film: Path, weights: str) -> None:
    lines = list(advice(load(GRAPH, overlay(film, f"saliency.weights={weights}"))))

    assert "saliency: the detector finds person, dog; it was trained on nothing" in lines
    assert not any("warning" in line for line in lines)


def test_a_class_that_it_does_not_know_is_refused_with_those_it_knows(
    film: Path, weights: str
) -> None:
    changes = overlay(film, f"saliency.weights={weights}", "policy.target=persn")

    with pytest.raises(SettingsError) as caught:
        list(advice(load(GRAPH, changes)))

    said = "policy.target: expected one of person, dog, got persn, did you mean 'person'?"
    assert str(caught.value) == said


@pytest.mark.parametrize("command", ["check", "run"])
def test_without_the_weights_the_error_has_the_command_that_gets_them(command: str) -> None:
    done: Result = CliRunner().invoke(commands, [command, "follow"])

    assert isinstance(done.exception, WeightsError)
    assert "saliency: yolox_nano: expected" in str(done.exception)
    assert "run `fovea weights pull yolox_nano`" in str(done.exception)


def test_the_graph_itself_is_checked_without_the_weights() -> None:
    assert [node.name for node in load(GRAPH).nodes][:3] == ["capture", "downsample", "saliency"]


@pytest.mark.footage
def test_a_person_in_a_street_is_followed(footage: Footage) -> None:
    footage.weights("yolox_nano")
    street = footage.data("street/street_720p.mp4")
    eye = Detector(SaliencySettings(weights="yolox_nano", confidence=0.3))
    heard: dict[str, Any] = {}
    shown = []
    plan = load(GRAPH, overlay(street, "policy.target=person"))

    with InlineRunner(plan, watch=lambda n, m: heard.update({n: m})) as runner:
        for seq in runner.run(60):
            if seq >= 10 and seq % 5 == 0:  # looked at closely, at the ROI's own resolution
                found, _, _ = eye.look(np.asarray(heard["capture.roi"].pixels, np.uint8))
                shown.append("person" in {eye.names[row] for row in found.classes})

    assert np.mean(shown) > 0.7
