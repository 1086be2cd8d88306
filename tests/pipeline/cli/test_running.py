"""The advice of operators is shown before anything starts."""

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from pipeline.cli import commands
from pipeline.cli.running import advice
from pipeline.errors import SettingsError, WeightsError
from pipeline.graph.advice import before
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay

ROOT = Path(__file__).resolve().parents[3]
GRAPHS = ROOT / "graphs"


@pytest.fixture(autouse=True)
def bare_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))


def with_network(name: str, tmp_path: Path) -> Path:
    """Return a shipped graph whose tracker needs weights that are missing."""
    text = (GRAPHS / name).read_text().replace("TemplateTracker", "VitTracker")
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["tracking.yaml", "multi_host.yaml"])
def test_the_shipped_graphs_need_nothing_but_the_repository(name: str) -> None:
    assert not any("warning" in line for line in advice(load(GRAPHS / name)))


def test_a_source_of_another_kind_is_warned_of_through_all_nodes_between(tmp_path: Path) -> None:
    overlay = Overlay(
        source=GRAPHS / "sources" / "video.yaml", changes=(f"capture.path={tmp_path / 'walk.mp4'}",)
    )

    lines = list(advice(load(GRAPHS / "tracking.yaml", overlay)))

    assert any(line.startswith("saliency: warning: the detector is for soccer") for line in lines)


def test_missing_weights_refuse_a_graph_before_a_process_starts(tmp_path: Path) -> None:
    graph = with_network("tracking.yaml", tmp_path)

    for command in ("check", "run"):
        done = CliRunner().invoke(commands, [command, str(graph)])
        assert isinstance(done.exception, WeightsError)
        assert "tracker: vittrack: " in str(done.exception)
        assert "run `fovea weights pull vittrack`" in str(done.exception)


def test_weights_that_another_host_must_have_are_advised_of(tmp_path: Path) -> None:
    lines = list(advice(load(with_network("multi_host.yaml", tmp_path))))

    assert any(line.startswith("tracker: on viewer: vittrack: expected") for line in lines)


def test_a_class_that_the_detector_does_not_know_refuses_a_graph() -> None:
    plan = load(GRAPHS / "tracking.yaml", Overlay(changes=("policy.target=playr",)))

    with pytest.raises(SettingsError) as caught:
        list(advice(plan))

    said = "policy.target: expected one of player, referee, ball, got playr, did you mean 'player'?"
    assert str(caught.value) == said


def test_nodes_that_one_depends_on_come_nearest_first_and_without_itself() -> None:
    plan = load(GRAPHS / "tracking.yaml")

    assert before(plan, "dispatch") == [
        "policy", "association", "verify", "kits", "downsample", "roi_features", "closer",
        "capture", "saliency",
    ]  # fmt: skip
    assert before(plan, "capture")[0] == "dispatch"


@pytest.mark.lengthy
def test_running_shows_the_advice_first() -> None:
    words = ["run", str(GRAPHS / "tracking.yaml"), "--inline", "--frames", "1"]
    command = [sys.executable, "-m", "pipeline.entry", *words]

    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)

    assert done.returncode == 0, done.stderr
    told = " ".join(done.stdout.split())  # the path of the graph decides where lines break
    assert told.index("the detector finds player") < told.index("rate: ")
