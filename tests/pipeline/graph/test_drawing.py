"""`fovea draw --text` says what every input reads, of which type, by which policy, and where."""

import pytest

from pipeline.graph.drawing import listing
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import graph_path
from tests.commands import command


@pytest.fixture(scope="module")
def drawn() -> list[str]:
    return listing(load(graph_path("multi_host"))).splitlines()


def test_every_edge_has_its_type_and_load_policy(drawn: list[str]) -> None:
    plan = load(graph_path("multi_host"))

    assert sum(" ← " in line for line in drawn) == len(plan.edges)
    assert any("frame ← capture.context  Frame, latest" in line for line in drawn)
    assert any("detections ← saliency  Detections, every" in line for line in drawn)
    assert any(
        "← dispatch  RoiSchedule, latest" in line and "sensor command" in line for line in drawn
    )


def test_every_node_has_its_host_and_writers_come_first(drawn: list[str]) -> None:
    plan = load(graph_path("multi_host"))
    heads = [line for line in drawn if not line.startswith(" ")]

    assert [head.split()[0] for head in heads] == list(plan.order())
    assert all(f"host {plan.node(head.split()[0]).host}" in head for head in heads)


def test_in_lockstep_every_edge_is_lossless() -> None:
    plan = load(graph_path("tracking"), Overlay(clock="lockstep"))

    edges = [line for line in listing(plan).splitlines() if " ← " in line]
    assert len(edges) == len(plan.edges)
    assert all(", every" in line for line in edges)


def test_the_command_prints_it() -> None:
    done = command("draw", "tracking", "--text")

    assert done.returncode == 0, done.stderr
    assert "tracks ← association  Tracks" in done.stdout
