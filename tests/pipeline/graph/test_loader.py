"""A wrong graph is refused before anything starts, with the line and what was expected."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import FoveaError, GraphError
from pipeline.graph.drawing import mermaid
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, manual_nodes
from pipeline.graph.plan import slots
from pipeline.graph.schema import graph_schema

GOOD = """\
name: toy
clock: realtime
nodes:
  ticker:
    operator: tests.samples:Ticker
    inputs: {schedule: steer}
    settings: {rate_hz: 50}
  work:
    operator: tests.samples:Pass
    inputs: {frame: ticker.context}
  pair:
    operator: tests.samples:Pair
    inputs:
      left: work
      right: {from: ticker.roi, keep: every, depth: 3}
  steer:
    operator: tests.samples:Steer
    inputs: {percept: pair}
"""


def write(folder: Path, text: str, name: str = "toy.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_good_graph_becomes_a_plan(tmp_path: Path) -> None:
    plan = load(write(tmp_path, GOOD))

    assert plan.order() == ("ticker", "work", "pair", "steer")
    assert [(e.origin, e.end) for e in plan.edges] == [
        ("steer", "ticker.schedule"),
        ("ticker.context", "work.frame"),
        ("work", "pair.left"),
        ("ticker.roi", "pair.right"),
        ("pair", "steer.percept"),
    ]
    assert plan.edges[3].keep == "every"
    assert plan.edges[0].command


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("frame: ticker.context", "frame: tiker.context", 10, "did you mean 'ticker.context'"),
        ("frame: ticker.context", "frame: ticker.contxt", 10, "did you mean 'ticker.context'"),
        ("frame: ticker.context", "fram: ticker.context", 10, "did you mean 'frame'"),
        (
            "frame: ticker.context",
            "frame: ticker",
            10,
            "ticker has several outputs, name one: ticker.context, ticker.roi",
        ),
        ("{rate_hz: 50}", "{rate_hz: fast}", 7, "ticker.rate_hz"),
        ("{rate_hz: 50}", "{rate_hz: -1}", 7, "must be positive, got -1"),
        ("{rate_hz: 50}", "{rate: 50}", 7, "did you mean 'rate_hz'"),
        ("tests.samples:Pass", "tests.samples:Past", 9, "cannot be imported"),
        ("tests.samples:Pass", "json:dumps", 9, "expected an Operator"),
        ("percept: pair", "percept: work", 18, "expected Percept, got Frame"),
        ("left: work", "left: 3", 14, "expected node or node.output"),
        ("keep: every", "keep: evry", 15, "did you mean every"),
        ("depth: 3", "depth: 0", 15, "expected 1 to 64"),
        ("    inputs: {percept: pair}\n", "", 17, "required, got nothing"),
        ("clock: realtime", "clock: sometime", 2, "expected realtime or lockstep"),
        ("clock: realtime", "clok: realtime", 2, "did you mean 'clock'"),
        ("schedule: steer", "schedule: {from: steer, keep: every}", 6, "always latest"),
        (
            "    operator: tests.samples:Steer",
            "    operator: 7",
            17,
            "expected an import path module:Class",
        ),
        ("  work:", "  work: [", 10, "not YAML"),
    ],
)
def test_a_wrong_graph_is_refused_with_its_line(
    tmp_path: Path, old: str, new: str, line: int, said: str
) -> None:
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new))

    with pytest.raises(FoveaError) as caught:
        load(path)

    assert str(caught.value).startswith(f"{path}:{line}"), str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize("operator", ["tests.samples:Past", "json:dumps", "tests.faulty_samples:x"])
def test_a_change_of_a_node_whose_operator_is_wrong_is_refused_with_its_line(
    operator: str, tmp_path: Path
) -> None:
    path = write(tmp_path, GOOD.replace("tests.samples:Pass", operator))

    with pytest.raises(GraphError) as caught:
        load(path, Overlay(changes=("work.every=3",)))

    assert str(caught.value).startswith(f"{path}:9: work.operator: {operator}"), str(caught.value)


def test_a_loop_without_a_sensor_command_is_refused(tmp_path: Path) -> None:
    text = GOOD + "  echo:\n    operator: tests.samples:PassEvery\n    inputs: {frame: mirror}\n"
    text += "  mirror:\n    operator: tests.samples:PassEvery\n    inputs: {frame: echo}\n"

    with pytest.raises(GraphError, match="echo, mirror wait for one another"):
        load(write(tmp_path, text))


def test_a_loop_for_which_nothing_waits_is_allowed(tmp_path: Path) -> None:
    text = GOOD + "  judge:\n    operator: tests.samples:Tally\n    inputs: {frame: guess}\n"
    text += "  guess:\n    operator: tests.samples:Corrected\n"
    text += "    inputs: {frame: ticker.context, told: judge}\n"

    plan = load(write(tmp_path, text))

    assert plan.order().index("guess") < plan.order().index("judge")
    assert "judge" not in plan.command_path()
    lossless = text.replace("told: judge", "told: {from: judge, keep: every}")
    with pytest.raises(GraphError, match="unjoined input that may lose in every loop"):
        load(write(tmp_path, lossless))


def test_in_lockstep_every_edge_is_lossless(tmp_path: Path) -> None:
    plan = load(write(tmp_path, GOOD), Overlay(clock="lockstep"))

    assert {edge.keep for edge in plan.edges} == {"every"}


def test_one_value_is_changed_from_outside(tmp_path: Path) -> None:
    plan = load(write(tmp_path, GOOD), Overlay(changes=("ticker.rate_hz=12.5", "work.every=3")))

    assert plan.node("ticker").settings["rate_hz"] == 12.5
    assert plan.node("work").settings["every"] == 3


@pytest.mark.parametrize("change", ["ticker", "ticker.rate_hz", "=1", "tikker.rate_hz=1", "a.b=["])
def test_a_change_that_means_nothing_is_refused(tmp_path: Path, change: str) -> None:
    with pytest.raises(FoveaError, match="--set"):
        load(write(tmp_path, GOOD), Overlay(changes=(change,)))


def test_a_source_file_is_laid_over_the_node_that_makes_frames(tmp_path: Path) -> None:
    source = write(tmp_path, "settings: {rate_hz: 9, length: 4}\n", "source.yaml")

    plan = load(write(tmp_path, GOOD), Overlay(source=source))

    assert plan.node("ticker").settings == {"rate_hz": 9, "length": 4}


def test_a_manual_node_starts_only_when_wanted(tmp_path: Path) -> None:
    text = GOOD + "  count:\n    operator: tests.samples:Count\n    manual: true\n"
    path = write(tmp_path, text + "    inputs: {frame: ticker.roi}\n")

    assert len(load(path).nodes) == 4
    assert len(load(path, Overlay(wanted=("count",))).nodes) == 5
    assert manual_nodes(path, "sleep_s") == ["count"]


def test_slots_cover_what_every_reader_may_hold(tmp_path: Path) -> None:
    plan = load(write(tmp_path, GOOD))

    assert slots(plan.readers("ticker", "roi")) == 2 + 3 + 1
    assert slots(plan.readers("ticker", "context")) == 2 + 8 + 1


def test_the_schema_is_json_and_knows_the_settings(tmp_path: Path) -> None:
    document = json.loads(json.dumps(graph_schema(load(write(tmp_path, GOOD)))))

    nodes = document["properties"]["nodes"]["properties"]
    assert "rate_hz" in nodes["ticker"]["properties"]["settings"]["properties"]
    assert set(nodes["pair"]["properties"]["inputs"]["properties"]) == {"left", "right"}


def test_the_drawing_shows_commands_dotted_and_lossless_edges_thick(tmp_path: Path) -> None:
    chart = mermaid(load(write(tmp_path, GOOD)))

    assert 'steer -.->|"schedule<br/>RoiSchedule, latest, sensor command"| ticker' in chart
    assert 'ticker ==>|"roi to right<br/>Frame, every"| pair' in chart


@given(st.text(max_size=200))
def test_any_text_is_refused_in_one_sentence(tmp_path_factory: object, text: str) -> None:
    path = Path("/dev/shm") / f"fovea-test-{abs(hash(text))}.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    try:
        with pytest.raises(FoveaError):
            load(path)
    finally:
        path.unlink()
