"""`fovea draw` says what every input reads, of which type, by which policy, and where."""

from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.graph.drawing import listing, mermaid
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.picture import lanes_of, svg
from pipeline.graph.shipped import graph_path
from tests.commands import command

SVG = "{http://www.w3.org/2000/svg}"


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


def test_the_chart_has_types_policies_and_hosts() -> None:
    lines = mermaid(load(graph_path("multi_host"))).splitlines()

    assert '  subgraph host_sensor["host sensor"]' in lines
    assert '  saliency ==>|"detections<br/>Detections, every"| association' in lines
    assert sum(line.startswith("  subgraph") for line in lines) == lines.count("  end")


def test_the_picture_has_every_node_and_an_arrow_for_every_edge() -> None:
    plan = load(graph_path("multi_host"))

    root = Xml.fromstring(svg(plan, {"tracker.roi": "29.9/s"}))
    texts = [text.text or "" for text in root.iter(f"{SVG}text")]
    arrows = [path for path in root.iter(f"{SVG}path") if path.find(f"{SVG}title") is not None]

    assert {node.name for node in plan.nodes} <= set(texts)
    assert len(arrows) == len(plan.edges)
    assert "roi ← capture.roi · Frame, latest, 29.9/s" in texts
    assert sum("stroke-dasharray" in arrow.attrib for arrow in arrows) == 1


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)).map(sorted), max_size=20))
def test_lines_that_share_a_row_have_lanes_of_their_own(spans: list[list[int]]) -> None:
    lanes = lanes_of([(first, last) for first, last in spans])

    for i, one in enumerate(spans):
        for k, other in enumerate(spans[:i]):
            if one[0] <= other[1] and other[0] <= one[1]:
                assert lanes[i] != lanes[k]


def test_an_unknown_graph_has_no_live_rates() -> None:
    done = command("draw", "tracking", "--live")

    assert done.returncode == 1
    assert "no graph tracking runs" in done.stderr
