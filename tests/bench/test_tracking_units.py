"""Units of an evaluation are known by what their figures come from."""

from pathlib import Path

import pytest

from bench.tracking.episode import Rules
from bench.tracking.units import Case, Protocol, key

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "tracking.yaml"


def keyed(graph: Path = GRAPH, strategy: str = "foveated", *changes: str) -> str:
    case = Case(strategy=strategy, budget="1/8", name="", rules=Rules(), changes=changes)
    return key(case, Protocol(graph=str(graph), frames=(1, 9), kinds=("ball",)))


def test_a_unit_is_another_with_other_weights(tmp_path: Path) -> None:
    weights, keys = tmp_path / "policy.onnx", []
    for content in (b"a", b"b", b"a"):
        weights.write_bytes(content)
        keys.append(keyed(GRAPH, "foveated", f"policy.weights={weights}"))

    assert keys[0] == keys[2] != keys[1]


def test_a_unit_is_the_same_in_another_place_and_another_with_other_settings(
    tmp_path: Path,
) -> None:
    copy, other = tmp_path / "copy.yaml", tmp_path / "other.yaml"
    copy.write_text(GRAPH.read_text() + "# a comment\n")
    other.write_text(GRAPH.read_text().replace("target: ball", "target: referee"))

    assert keyed(copy) == keyed() != keyed(other)
    assert keyed(other, "spatial") == keyed(GRAPH, "spatial")


def test_a_unit_is_another_once_the_code_of_a_part_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, graph = tmp_path / "seer.py", tmp_path / "tracking.yaml"
    graph.write_text(GRAPH.read_text().replace("operators.policy:Policy", "seer:Policy"))
    monkeypatch.syspath_prepend(str(tmp_path))
    code.write_text("from operators.policy import Policy\n")
    before, plain = keyed(graph), keyed(graph, "spatial")

    code.write_text("from operators.policy import Policy  # and more\n")

    assert keyed(graph) != before
    assert keyed(graph, "spatial") == plain
