"""Evaluation of the manipulation task: rows, intervals, and a table of real trials."""

import json
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from bench.manipulation.evaluate import GRAPH, command, key
from bench.manipulation.intervals import paired, wilson
from bench.manipulation.rows import Row, parsed, rows_of
from bench.manipulation.trial import Job, needed, plan_of
from pipeline.errors import SettingsError

SIXTEENTH = Fraction(1, 16)


@given(st.integers(1, 500), st.data())
def test_the_interval_of_a_share_holds_it_and_narrows(trials: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(0, trials))

    low, high = wilson(count, trials)
    wider = wilson(4 * count, 4 * trials)

    assert 0 <= low <= count / trials <= high <= 1
    assert wider[1] - wider[0] < high - low


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=200))
def test_a_paired_difference_changes_its_sign_with_the_sides(
    pairs: list[tuple[bool, bool]],
) -> None:
    ours, theirs = [a for a, _ in pairs], [b for _, b in pairs]

    apart, low, high = paired(ours, theirs)
    back = paired(theirs, ours)

    assert -1 <= low <= high <= 1
    assert back == pytest.approx((-apart, -high, -low))


def test_every_row_keeps_to_its_budget_and_full_resolution_has_none() -> None:
    job = Job(graph=str(GRAPH), changes=())

    rows = rows_of(["all"], parsed("1/8,1/16,1/32"), plan_of(job))

    for row in rows:
        plan_of(job, *row.changes)  # the sensor refuses what goes over the budget
    assert [row.strategy for row in rows].count("full") == 1
    assert {row.strategy for row in rows} >= {"spatial", "temporal", "exposure", "centred"}


def test_the_oracle_is_a_row_only_where_its_object_is_named() -> None:
    unnamed, named = (
        plan_of(Job(graph=str(GRAPH), changes=changes))
        for changes in ((), ("robot.oracle_label=peg",))
    )

    assert "oracle" not in {row.strategy for row in rows_of(["all"], [SIXTEENTH], unnamed)}
    assert "oracle" in {row.strategy for row in rows_of(["all"], [SIXTEENTH], named)}
    with pytest.raises(SettingsError, match=r"oracle needs .* --set robot.oracle_label=peg"):
        rows_of(["oracle"], [SIXTEENTH], unnamed)


def test_what_cannot_be_measured_is_refused() -> None:
    plan = plan_of(Job(graph=str(GRAPH), changes=()))

    with pytest.raises(SettingsError, match="expected all"):
        rows_of(["sideways"], [SIXTEENTH], plan)
    with pytest.raises(SettingsError, match="centred has"):
        rows_of(["centred"], [Fraction(1, 5)], plan)
    for text in ("", "1/0", "2", "x"):
        with pytest.raises(SettingsError, match="budgets"):
            parsed(text)


@pytest.mark.parametrize("name", ["report", "markdown"])
def test_a_table_that_cannot_be_written_is_refused_before_any_trial(
    tmp_path: Path, name: str
) -> None:
    words = ["--work", str(tmp_path / "work"), f"--{name}", str(tmp_path)]

    result = CliRunner().invoke(command, words)

    assert result.exit_code == 2
    assert f"{name}: expected a file that can be written, got {tmp_path}" in result.output


def test_a_row_runs_only_what_its_strategy_needs() -> None:
    job = Job(graph=str(GRAPH), changes=())

    def names(strategy: str) -> set[str]:
        changes = Row(strategy=strategy, budget=SIXTEENTH).changes
        return {node.name for node in needed(plan_of(job, *changes)).nodes}

    assert names("spatial") == names("centred") == {"robot", "manipulation"}
    assert names("foveated") >= {"saliency", "policy", "dispatch"}
    assert "visualise" not in names("foveated")


def test_rows_are_told_apart_by_what_determines_them() -> None:
    def keyed(*changes: str) -> str:
        return key(Job(graph=str(GRAPH), changes=changes))

    centred = Row(strategy="centred", budget=SIXTEENTH).changes

    assert keyed(*centred) == keyed(*centred)
    assert keyed(*centred) != keyed(*Row(strategy="spatial", budget=SIXTEENTH).changes)
    assert keyed(*centred) != keyed(*centred, "manipulation.decay=0.5")


@pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha") and find_spec("onnx")),
    reason="needs the robot and the train extras",
)
def test_a_table_is_measured_written_and_taken_up_again(tmp_path: Path) -> None:
    from tests.operators.manipulation.test_manipulation import network

    weights = network(tmp_path / "act.onnx", joints=14)
    options = [
        f"--consumer={weights}", "--trials=2", "--seed=80000", "--strategies=full,centred",
        "--budgets=1/16", "--jobs=1", f"--report={tmp_path / 'table.json'}",
        f"--markdown={tmp_path / 'table.md'}", "--set=robot.frames=3",
    ]  # fmt: skip

    first = CliRunner().invoke(command, options)
    work = tmp_path / "table.work"
    dates = {path: path.stat().st_mtime_ns for path in work.iterdir()}
    again = CliRunner().invoke(command, [*options, "--markdown=-"])

    assert (first.exit_code, again.exit_code) == (0, 0), first.output
    assert {path: path.stat().st_mtime_ns for path in work.iterdir()} == dates
    report = json.loads((tmp_path / "table.json").read_text())
    assert report["bench"] == "manipulation"
    full, centred = report["rows"]
    assert (full["pixels"], full["rewards"], full["complete"]["share"]) == (1, [0, 0], 0)
    assert centred["pixels"] <= 1 / 16
    assert centred["complete"]["difference_to_full"][0] == 0
    text = (tmp_path / "table.md").read_text()
    assert "| centred | 1/16 | 0.00 |" in text
    assert again.stdout.endswith(f"{text}\n")
