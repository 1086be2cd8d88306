"""Units of an evaluation are known by what their figures come from."""

import json
from pathlib import Path

import pytest

from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName
from bench.tracking.episode import Rules
from bench.tracking.units import Draft, key, measured

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


def test_an_unfinished_unit_keeps_what_it_has_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.tracking.units.KEEP_S", 0.0)
    Draft(tmp_path / "unit.part").add(3, {"start": 8, "iou": [0.5]})

    again = Draft(tmp_path / "unit.part")

    assert again.known(3, 8) == {"start": 8, "iou": [0.5]}
    assert again.known(3, 16) is again.known(2, 8) is None
    again.finish([], tmp_path / "unit.json")
    assert [path.name for path in tmp_path.iterdir()] == ["unit.json"]


def test_an_interrupted_unit_goes_on_within_a_clip(tmp_path: Path) -> None:
    clips, changes = [ClipName(seed=70_003)], ("tracker.method=correlation",)
    case = Case(strategy="spatial", budget="1/8", name="spatial", rules=Rules(), changes=changes)
    protocol = Protocol(graph=str(GRAPH), frames=(1, 20), kinds=("ball",))
    (whole,) = measured(clips, [case], protocol, tmp_path, jobs=1)
    (file,) = tmp_path.iterdir()
    first, *others = whole["episodes"]
    assert others
    marked = {**first, "iou": [0.125] * len(first["iou"])}
    file.with_suffix(".part").write_text(
        json.dumps({f"{whole['target']} {first['start']}": marked})
    )
    file.unlink()

    (again,) = measured(clips, [case], protocol, tmp_path, jobs=1)

    assert again["episodes"] == [marked, *others]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
