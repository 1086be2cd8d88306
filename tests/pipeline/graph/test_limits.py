"""Names and numbers of a graph have the same limits in files, messages and the JSON schema."""

import json
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from bench.fuzz import nasty
from pipeline import FoveaError, GraphError
from pipeline.graph.limits import EDGE, NODE, RESTART
from pipeline.graph.loader import load
from pipeline.graph.plan import Restart
from pipeline.graph.schema import graph_schema
from pipeline.graph.yaml_lines import YamlFile, plain
from tests.pipeline.graph.test_loader import GOOD, write
from tests.pipeline.test_naming import NO_NAMES

YAML_NAMES = [*(json.dumps(n) for n in NO_NAMES if n.isprintable()), "null", "5", "[a]", "true"]


@pytest.mark.parametrize("name", YAML_NAMES)
@pytest.mark.parametrize(
    ("old", "line"),
    [
        ("name: toy", 1),
        ("  work:\n", 8),
        ("    operator: tests.samples:Pass\n", 10),
        ("inputs: {frame", 10),
    ],
    ids=["graph", "node", "group", "input"],
)
def test_what_is_no_name_is_refused_with_its_line(
    tmp_path: Path, name: str, old: str, line: int
) -> None:
    new = {
        1: f"name: {name}",
        8: f"  {name}:\n",
        10: f"inputs: {{{name}" if "inputs" in old else f"{old}    group: {name}\n",
    }[line]
    path = write(tmp_path, GOOD.replace(old, new, 1))

    with pytest.raises(FoveaError) as caught:
        load(path)

    assert str(caught.value).startswith(f"{path}:{line}: "), str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_graph_without_a_name_takes_that_of_its_file_or_is_refused(tmp_path: Path) -> None:
    text = GOOD.replace("name: toy\n", "")

    assert load(write(tmp_path, text, "toy.yaml")).name == "toy"
    with pytest.raises(GraphError, match=r"my toy\.yaml:1: name: the graph has none"):
        load(write(tmp_path, text, "my toy.yaml"))


@pytest.mark.parametrize("value", ["-1", ".inf", ".nan", "abc", "[1]", "true", "~", "1e300", "'1'"])
@pytest.mark.parametrize("key", [*NODE, *EDGE, *(f"restart.{k}" for k in RESTART)])
def test_a_number_out_of_range_is_refused_with_its_line(
    tmp_path: Path, key: str, value: str
) -> None:
    old, new = "  work:\n", f"  work:\n    {key}: {value}\n"
    if key.startswith("restart."):
        new = f"  work:\n    restart:\n      {key.partition('.')[2]}: {value}\n"
    if key in EDGE:
        old, new = "keep: every, depth: 3}", f"keep: every,\n       {key}: {value}}}"
    path = write(tmp_path, GOOD.replace(old, new))
    line = GOOD[: GOOD.index(old)].count("\n") + new.count("\n") + (key in EDGE)

    with pytest.raises(FoveaError) as caught:
        load(path)

    assert str(caught.value).startswith(f"{path}:{line}: "), str(caught.value)


@pytest.mark.parametrize("value", ["'no'", "no", "1", "~", "[]"])
def test_manual_is_true_or_false(tmp_path: Path, value: str) -> None:
    path = write(tmp_path, GOOD.replace("  work:\n", f"  work:\n    manual: {value}\n"))

    with pytest.raises(GraphError, match=r":9: work\.manual: expected true or false"):
        load(path)


@pytest.mark.parametrize("limits", [NODE, EDGE, RESTART])
def test_the_ends_of_every_range_are_within_it(limits: dict[str, Any]) -> None:
    for name, limit in limits.items():
        for value in (limit.low, limit.high):
            limit.check(int(value) if limit.whole else value, name)
        for value in (limit.low - 1, limit.high + 1, limit.high * 2, float("nan"), True, None, "1"):
            with pytest.raises(GraphError, match=f"{name}: expected"):
                limit.check(value, name)


def test_a_restart_policy_holds_its_limits_wherever_it_is_made() -> None:
    with pytest.raises(FoveaError, match="most: expected 0 to 10000, got -1"):
        Restart(most=-1)


@settings(max_examples=150)
@given(st.integers(0, 2**32), st.integers(1, 3))
def test_loader_and_schema_agree(
    tmp_path_factory: pytest.TempPathFactory, seed: int, changes: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    good = write(folder, GOOD, "good.yaml")
    document = nasty.spoilt(plain(YamlFile(good).document), random.Random(seed), changes)
    text = nasty.written(document)
    path = write(folder, text)

    try:
        load(path)
    except FoveaError as error:  # the schema may accept it: it knows no operators
        said = str(error)
    else:
        said = ""
        found = plain(YamlFile(path).document)
        Draft202012Validator(graph_schema()).validate(found)
        Draft202012Validator(graph_schema(load(good))).validate(found)
    assert "\n" not in said
    assert said.startswith(f"{path}:") or not said


WHOLE_FLOATS = st.one_of(st.integers(-2, 66).map(float), st.sampled_from([3.5, 1e18, 1e20, 1e300]))
ORIGINS = (
    "ticker.roi", "", ".", "ticker.", ".roi", "ticker.roi.x", "ticker..roi", "tick er", "a" * 33
)  # fmt: skip
EDGE_VALUES = {
    "keep": st.sampled_from(["latest", "every"]), "stale": st.sampled_from(["drop", "pass"]),
    "depth": st.one_of(st.integers(0, 66), WHOLE_FLOATS),
    "wait_ms": st.floats(-1, 1e9), "max_age_ms": st.floats(-1, 1e12),
    "transport": st.sampled_from(["pool", "bytes", "tcp"]),
}  # fmt: skip
NODE_VALUES = {
    "threads": st.one_of(st.integers(0, 66), WHOLE_FLOATS), "stall_s": st.floats(0, 1e6),
    "memory_mb": st.floats(-1, 1e8),
    "group": st.sampled_from(["a", "a b", "x" * 33]), "manual": st.booleans(),
    "restart": st.sampled_from(["never", "on-failure", "sometimes", {"most": 3}, {"most": -3},
                                {"most": 3.0}, {"most": 3.5}, {"most": 1e18}]),
}  # fmt: skip


SETTING_VALUES = st.one_of(
    st.integers(1, 2**64), WHOLE_FLOATS.filter(lambda v: v >= 1), st.floats(1, 1e9),
    st.sampled_from([True, None, "3", [3], {}, 2.5, 1e19, 2**64]),
)  # fmt: skip
NUMBERS = ("sleep_s", "crash_at", "crash_after", "hang_at", "every", "hold", "gain")


@settings(max_examples=100)
@given(st.dictionaries(st.sampled_from(NUMBERS), SETTING_VALUES, max_size=3))
def test_schema_and_loader_agree_on_settings(
    tmp_path_factory: pytest.TempPathFactory, values: dict[str, Any]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    good = write(folder, GOOD, "good.yaml")
    document = plain(YamlFile(good).document)
    document["nodes"]["work"]["settings"] = values
    path = write(folder, json.dumps(document))

    fits = Draft202012Validator(graph_schema(load(good))).is_valid(document)
    try:
        load(path)
        refused = ""
    except FoveaError as error:
        refused = str(error)
    assert fits == (not refused), refused
    assert refused.startswith(f"{path}:") or not refused


@pytest.mark.parametrize("origin", ORIGINS)
def test_schema_and_loader_agree_on_origins(tmp_path: Path, origin: str) -> None:
    document = plain(YamlFile(write(tmp_path, GOOD)).document)
    for value in (origin, {"from": origin}):
        document["nodes"]["pair"]["inputs"]["right"] = value
        path = write(tmp_path, json.dumps(document))

        fits = Draft202012Validator(graph_schema()).is_valid(document)
        if origin == ORIGINS[0]:
            load(path)
            assert fits
        else:
            with pytest.raises(GraphError, match=r"pair\.inputs\.right: expected node or node"):
                load(path)
            assert not fits


def test_a_whole_float_is_a_whole_number_everywhere(tmp_path: Path) -> None:
    text = GOOD.replace("depth: 3", "depth: 3.0").replace(
        "  work:\n", "  work:\n    threads: 2.0\n    restart: {most: 4.0}\n"
    )
    document = plain(YamlFile(write(tmp_path, text)).document)
    document["nodes"]["work"]["settings"] = {"every": 5.0}

    plan = load(write(tmp_path, json.dumps(document)))

    work = plan.node("work")
    found = [work.threads, work.restart.most, *(e.depth for e in plan.edges if e.depth == 3)]
    assert [repr(value) for value in found] == ["2", "4", "3"]


@settings(max_examples=100)
@given(
    st.fixed_dictionaries({}, optional=EDGE_VALUES), st.fixed_dictionaries({}, optional=NODE_VALUES)
)
def test_what_a_schema_says_of_nodes_and_edges_is_what_the_loader_says(
    tmp_path_factory: pytest.TempPathFactory, edge: dict[str, Any], node: dict[str, Any]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    document = plain(YamlFile(write(folder, GOOD)).document)
    document["nodes"]["pair"]["inputs"]["right"] = {"from": "ticker.roi", **edge}
    document["nodes"]["extra"] = {
        "operator": "tests.samples:Count", "inputs": {"frame": "ticker.roi"}, **node
    }  # fmt: skip
    path = write(folder, json.dumps(document))

    fits = Draft202012Validator(graph_schema()).is_valid(document)
    try:
        load(path)
        refused = ""
    except FoveaError as error:
        refused = str(error)
    assert fits == (not refused), refused
