"""One table of the run time of several tasks, from reports of the loop."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from bench.results.table import read_table
from bench.task_times import main


def spread(value: float) -> dict[str, float]:
    return {"median": value, "min": value - 0.5, "max": value + 0.5}


def report(graph: str, *stages: str) -> dict[str, Any]:
    loop = [f"{name}_ms_{share}" for name in ("latency", "overhead") for share in ("p50", "p99")]
    return {
        "graph": graph, "frames": 60, "commit": "1234567890", "rounds": [{}, {}],
        "machine": {"cpu": "one", "cores": 2, "load_1min": 0.1},
        "summary": {
            "loop": {name: spread(20.0) for name in loop},
            "stages": {name: {"handler_p50_ms": spread(4.0)} for name in stages},
        },
    }  # fmt: skip


def made(folder: Path, *reports: Any) -> Any:
    paths = [folder / f"{number}.json" for number in range(len(reports))]
    for path, values in zip(paths, reports, strict=True):
        path.write_text(json.dumps(values))
    return CliRunner().invoke(main, [*map(str, paths), "--out", str(folder / "task_times.json")])


def test_every_task_is_a_row_and_the_paper_the_last(tmp_path: Path) -> None:
    one = report("graphs/text.yaml", "saliency", "policy", "reader")
    other = report("graphs/manipulation.yaml", "policy", "manipulation")

    result = made(tmp_path, one, other)

    assert result.exit_code == 0, result.output
    path = tmp_path / "task_times.json"
    table = read_table(path, path.read_bytes())
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert list(rows) == ["text", "manipulation", "the paper's parts, i7-7700HQ"]
    assert rows["text"]["saliency"] == rows["text"]["consumer"] == "4.0 (3.5–4.5)"
    assert rows["manipulation"]["saliency"] == "–"
    assert rows["text"]["picture → command"] == "20.0 (19.5–20.5) / 20.0 (19.5–20.5)"
    assert rows["the paper's parts, i7-7700HQ"]["saliency"] == "55"


@pytest.mark.parametrize("values", [{}, [], {"graph": 3}, {**report("a"), "summary": {}}])
def test_another_file_is_refused_in_one_sentence(tmp_path: Path, values: Any) -> None:
    result = made(tmp_path, values)

    assert result.exit_code == 1
    assert "0.json: expected a report of bench.loop" in result.output


def test_a_report_without_a_loop_is_refused(tmp_path: Path) -> None:
    open_loop = report("a")
    open_loop["summary"]["loop"] = {}

    assert "expected a report of bench.loop with" in made(tmp_path, open_loop).output
