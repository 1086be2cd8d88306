"""One table of all tasks, from their reports."""
# ruff: noqa: E501

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

pytest.importorskip("matplotlib")

from bench import tables
from bench.all_tasks import write_table
from bench.results.table import read_table
from bench.tables import RESULTS, main

TRACKING = {
    "commit": "1234567890", "graph": "tracking.yaml", "clips": ["a", "b"], "seed": 0,
    "rows": [
        {"clip": "all", "clips": 2, "target": "ball", "strategy": name, "budget": budget, "iou": iou}
        for name, budget, iou in (("full", "1", 0.6), ("pursuit", "1/8", 0.58), ("spatial", "1/8", 0.3))
    ] + [{"clip": "a", "clips": 1, "target": "ball", "strategy": "spatial", "budget": "1/8", "iou": 0.1}],
}  # fmt: skip
TEXT: dict[str, Any] = {
    "commit": "abcdef0123", "graph": "text.yaml", "clips": 10, "seed": 70_000,
    "rows": [
        {"strategy": name, "budget": budget, "read": read}
        for name, budget, read in (("full", "1", 0.9), ("foveated", "1/16", 0.7), ("greedy", "1/16", 0.6))
    ],
}  # fmt: skip
ROBOT = {
    "commit": "1234567890", "graph": "manipulation.yaml", "trials": 100, "seed": 70_000,
    "rows": [
        {"strategy": name, "budget": budget, "complete": {"share": 0.5}, "partial": {"share": 0.8}}
        for name, budget in (("full", "1"), ("spatial", "1/16"))
    ],
}  # fmt: skip


def made(folder: Path, *, only: str = "all-tasks", **reports: Any) -> Any:
    words = ["--out", str(folder / "out"), *(["--only", only] if only else [])]
    for task, report in reports.items():
        path = folder / f"{task}.json"
        path.write_text(json.dumps(report))
        words += [f"--{task}", str(path)]
    return CliRunner().invoke(main, words)


def test_tasks_stand_beside_one_another_and_beside_the_paper(tmp_path: Path) -> None:
    result = made(tmp_path, tracking=TRACKING, text=TEXT, manipulation=ROBOT)

    assert result.exit_code == 0, result.output
    path = tmp_path / "out" / "all_tasks.json"
    table = read_table(path, path.read_bytes())
    rows = {(row[0], row[1]): dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert rows["ball: IoU", "1/8"]["foveated"] == "0.580 | 0.283"
    assert rows["ball: IoU", "1/8"]["spatial"] == "0.300 | 0.122"
    assert rows["text: share read", "1/16"]["full"] == "0.900 | 0.333"
    assert rows["text: share read", "1/16"]["foveated"] == "0.700 | 0.227"
    assert rows["insertion: complete", "1/16"]["spatial"] == "0.500 | 0.100"
    assert rows["insertion: partial", "1/16"]["spatial"] == "0.800"
    assert table.commit == "1234567, abcdef0"
    assert (tmp_path / "out" / table.plot).stat().st_size > 5000


def test_the_table_is_among_the_tables_of_its_folder(tmp_path: Path) -> None:
    made(tmp_path, tracking=TRACKING, text=TEXT, manipulation=ROBOT)

    assert "| 0.580 \\| 0.283 |" in (tmp_path / "out" / "tables.md").read_text()
    assert set(json.loads((tmp_path / "out" / "tables.json").read_text())) == {"all-tasks"}


def test_without_reports_those_of_the_folder_and_the_committed_ones_are_taken(
    tmp_path: Path,
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "budgets.json").write_text(json.dumps(TRACKING))
    (tmp_path / "out" / "budgets.md").touch()

    result = made(tmp_path)

    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "out" / "all_tasks.json").read_text())["rows"]
    assert {row[0] for row in rows} == {
        *("ball: IoU", "text: share read", "insertion: complete", "insertion: partial"),
    }


def test_one_task_alone_is_a_table_too(tmp_path: Path) -> None:
    path = tmp_path / "text.json"
    path.write_text(json.dumps(TEXT))

    write_table({"text": path}, "ball", tmp_path)

    text = (tmp_path / "all_tasks.md").read_text()
    assert "text: share read" in text
    assert "ball" not in text


def test_a_table_of_strategies_is_taken_in_place_of_a_report(tmp_path: Path) -> None:
    shipped = RESULTS / "whole_pitch_short.json"

    write_table({"tracking": shipped}, "ball", tmp_path)

    table = json.loads((tmp_path / "all_tasks.json").read_text())
    assert table["rows"] == json.loads((RESULTS / "all_tasks.json").read_text())["rows"][:3]
    assert table["data"].endswith("(table whole_pitch_short)")


OTHER_FILES = [
    (
        {"tracking": {"columns": ["target", "budget", 1], "rows": [["ball", "1/8", ".5"]]}},
        "of strategies",
    ),
    (
        {"tracking": {"columns": ["target", "budget"], "rows": ["ball"]}},
        "expected a table of strategies",
    ),
    (
        {"tracking": {"columns": ["figure"], "rows": []}},
        "expected a report of fovea eval with rows",
    ),
    ({"text": [1]}, "expected a report of fovea eval with rows"),
    ({"text": TRACKING}, "--text: expected rows of that task"),
    ({"manipulation": TEXT}, "--manipulation: expected rows of that task"),
    (
        {"text": {"rows": [TEXT["rows"][0] | {"budget": "1/0"}]}},
        "--text: expected rows of that task",
    ),
    ({"tracking": TRACKING | {"rows": []}}, "--tracking: expected rows of ball, got none"),
]


@pytest.mark.parametrize(("reports", "sentence"), OTHER_FILES)
def test_other_files_are_refused_in_a_sentence(
    tmp_path: Path, reports: dict[str, Any], sentence: str
) -> None:
    result = made(tmp_path, **reports)

    assert result.exit_code == 1
    assert sentence in result.output


def test_a_report_that_is_missing_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    words = ["--out", str(tmp_path), "--text", str(tmp_path / "none.json")]

    result = CliRunner().invoke(main, words)

    assert result.exit_code == 1
    assert "none.json: expected a report of fovea eval, got no such file" in result.output


@pytest.mark.parametrize("only", ["", "budgets"])
@pytest.mark.parametrize(("reports", "sentence"), OTHER_FILES)
def test_other_files_are_refused_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, only: str, reports: dict[str, Any],
    sentence: str,
) -> None:  # fmt: skip
    begun: list[str] = []
    monkeypatch.setattr(tables, "check", begun.extend)

    result = made(tmp_path, only=only, **reports)

    assert result.exit_code == 1
    assert sentence in result.output
    assert begun == []
    assert list((tmp_path / "out").iterdir()) == []
