"""The page of results is generated from the committed files, and wrong files are refused."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from bench.machine import facts
from bench.results.figures import figures
from bench.results.page import FOLDER, PAGE, main, page
from bench.results.plots import curves_of
from bench.results.table import SECTIONS, ResultError, read_table

TABLE = {
    "id": "sample", "section": SECTIONS[1], "order": 0, "title": "A sample",
    "source": "README at commit 1234567", "columns": ["a", "b"], "rows": [[1, ".5 | .6"]],
}  # fmt: skip
ORIGIN = facts() | {"commit": "1234567" * 5}
LOOP = {"latency_ms_p50": 20, "latency_ms_p99": 40, "p50": 20}
ROOT = Path(__file__).resolve().parents[2]
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner),
)


def folder_of(folder: Path, **files: Any) -> Path:
    for name, values in files.items():
        (folder / f"{name}.json").write_text(json.dumps(values))
    return folder


def test_the_committed_page_is_what_the_committed_files_give() -> None:
    assert PAGE.read_text() == page(FOLDER), "run python -m bench.results"


def test_check_fails_when_the_page_is_not_what_the_files_give(tmp_path: Path) -> None:
    folder_of(tmp_path, sample=TABLE)
    out = tmp_path / "RESULTS.md"
    given_ = ["--folder", str(tmp_path), "--out", str(out)]

    missing = CliRunner().invoke(main, [*given_, "--check"])
    written = CliRunner().invoke(main, given_)
    same = CliRunner().invoke(main, [*given_, "--check"])
    folder_of(tmp_path, sample=TABLE | {"title": "Another"})
    changed = CliRunner().invoke(main, [*given_, "--check"])

    assert [r.exit_code for r in (missing, written, same, changed)] == [1, 0, 0, 1]
    assert "RESULTS.md: is not what" in changed.output
    assert "A sample" in out.read_text()


def test_transcribed_figures_are_marked_and_keep_their_cells(tmp_path: Path) -> None:
    text = page(folder_of(tmp_path, sample=TABLE))

    assert "- Source: transcribed: README at commit 1234567" in text
    assert "| 1 | .5 \\| .6 |" in text


def test_a_report_of_any_bench_shows_its_origin_figures_and_rows(tmp_path: Path) -> None:
    report = ORIGIN | {
        "bench": "loop", "dirty": True, "graph": "a.yaml", "summary": {"loop": {"p50": 24.1}},
        "rows": [{"node": "policy", "ms": 1.5}], "rounds": [[{"deep": 1}]],
    }  # fmt: skip

    text = page(folder_of(tmp_path, anything=report))

    assert "- Source: measured (`bench/results/anything.json`)" in text
    assert "- Commit: 1234567, with local changes" in text
    assert "- Run: graph a.yaml\n- summary: loop: p50 24.1" in text
    assert "| policy | 1.5 |" in text


def test_groups_with_the_same_figures_are_rows_of_one_table() -> None:
    spread = {"median": 2.0, "min": 1.0, "max": 3.5}
    estimate = {"mean": 0.7, "interval": [0.6, 0.8]}
    values = {
        "frames": 9,
        "worlds": {
            "drawn": {"ball": {"n": 8, "iou": estimate}, "player": {"n": 9, "ms": spread}},
            "footage": {"ball": {"n": 1, "iou": {"mean": 0.5, "interval": []}}},
        },
    }

    facts_, table = figures(values)

    assert facts_ == "- Run: frames 9\n- Ranges: mean (interval); median (min to max)"
    assert table.splitlines() == [
        "| worlds |  | n | iou | ms |",
        "|---|---|---|---|---|",
        "| drawn | ball | 8 | 0.7 (0.6 to 0.8) | – |",
        "| drawn | player | 9 | – | 2 (1 to 3.5) |",
        "| footage | ball | 1 | 0.5 | – |",
    ]


def test_a_few_groups_of_many_figures_are_the_columns_of_their_table() -> None:
    values = {"of": {name: {f"figure {n}": n for n in range(12)} for name in ("a", "b")}}

    (table,) = figures(values)

    assert table.splitlines()[:3] == ["| of | a | b |", "|---|---|---|", "| figure 0 | 0 | 0 |"]


def test_several_reports_of_the_loop_begin_with_one_table_of_all(tmp_path: Path) -> None:
    of = {name: {"median": ms, "min": ms, "max": ms + 1} for name, ms in LOOP.items()}
    report = ORIGIN | {"bench": "loop", "summary": {"loop": of, "sum_of_handlers_ms": of["p50"]}}

    text = page(folder_of(tmp_path, loop=report, loop_text=report))

    assert "| loop_text | 20 (20 to 21) | 40 (40 to 41) | – | 20 (20 to 21) |" in text
    assert text.index("| loop_text |") < text.index("#### loop\n") < text.index("#### loop_text")


def test_every_section_and_table_is_linked_at_the_top(tmp_path: Path) -> None:
    text = page(folder_of(tmp_path, sample=TABLE, other=TABLE | {"id": "other"}))

    assert "  - [A sample](#a-sample)\n  - [A sample](#a-sample-1)\n" in text


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ([], "expected an object"),
        ({}, "missing required field `machine`"),
        ({"id": "sample"}, "missing required field `section`"),
        (TABLE | {"id": "other"}, "id: expected sample, got other"),
        (TABLE | {"section": "?"}, "section: expected one of"),
        (TABLE | {"rows": [[1]]}, "rows[0]: expected 2 cells, got 1"),
        (TABLE | {"rows": [[1, [2]]]}, "expected `"),
        (TABLE | {"title": 3}, "expected `str`, got `int` - at `$.title`"),
        (TABLE | {"colums": []}, "unknown field `colums`"),
        (TABLE | {"plot": "none.png"}, "plot: expected a file beside it, got none.png"),
        (ORIGIN | {"commit": 3}, "expected `str`, got `int` - at `$.commit`"),
        (ORIGIN | {"machine": {}}, "missing required field `cpu`"),
        (ORIGIN | {"bench": "follow", "ends": [1]}, "expected `object`, got `array` - at `$.ends`"),
        (ORIGIN | {"bench": "soak"}, "object missing required field `memory`"),
    ],
)
def test_a_wrong_result_file_is_refused_in_one_sentence(
    tmp_path: Path, values: Any, what: str
) -> None:
    folder_of(tmp_path, sample=values)

    result = CliRunner().invoke(main, ["--folder", str(tmp_path), "--out", str(tmp_path / "x.md")])

    assert result.exit_code == 1
    assert result.output.startswith("Error: sample.json: ")
    assert what in result.output
    assert result.output.count("\n") == 1
    assert not (tmp_path / "x.md").exists()


@pytest.mark.parametrize("text", [b"", b"{", b"\xff", b"[" * 100_000])
def test_a_file_that_is_not_json_is_refused_by_name(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "sample.json").write_bytes(text)

    with pytest.raises(ResultError, match=r"^sample\.json: expected JSON, got "):
        page(tmp_path)


@given(values=JSON, more=st.dictionaries(st.sampled_from(["rows", "ends", "seed", "fuzz"]), JSON))
def test_any_json_gives_a_page_or_a_result_error(
    tmp_path_factory: pytest.TempPathFactory, values: Any, more: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("results")
    folder_of(folder, sample=values, report=ORIGIN | more, table=TABLE | more)

    try:
        text = page(folder)
    except ResultError as error:
        text = str(error)

    assert text


def test_every_test_that_the_table_of_examples_names_exists() -> None:
    rows = json.loads((FOLDER / "adversarial_examples.json").read_text())["rows"]
    texts = {path.name: path.read_text() for path in ROOT.glob("tests/**/test_*.py")}

    named = [re.findall(r"(test_\w+\.py)(?:::(test_\w+))?", row[-1]) for row in rows]

    assert all(named)
    for file, name in (pair for found in named for pair in found):
        assert f"def {name}" in texts[file], (file, name)


def test_a_soak_shows_its_verdict_its_memory_and_its_minutes(tmp_path: Path) -> None:
    ends = {"ball": {part: {"iou": 0.3} for part in ("first", "last", "grown")}}
    report = {
        **ORIGIN,
        "bench": "soak",
        "verdict": [{"about": "rate", "held": True, "sentence": "held: 30 frames/s"}],
        "memory": {"capture": {"first_mb": 1.0, "last_mb": 3.0, "grown_mb": 2.0}},
        "overlap": {"ends": ends, "rows": [{"span": 0, "target": "ball", "iou": 0.25}]},
    }
    (tmp_path / "soak.json").write_text(json.dumps(report))

    written = page(tmp_path)

    assert "- rate: held: 30 frames/s" in written
    assert "| capture | 1 | 3 | 2 |" in written
    assert "| ball | iou | 0.3 | 0.3 | 0.3 |" in written
    assert "| 0 | ball | 0.25 |" in written


def test_a_hop_shows_each_transport_at_each_size(tmp_path: Path) -> None:
    hop = {"nbytes": 65_536, "lost": 0, "beyond_ms": {"min": 0.1, "p50": 0.25, "p99": 1.5}}
    figures = [
        {**hop, "contestant": "zenoh_bytes", "lost": 3},
        {**hop, "contestant": "fovea_bus"},
        {**hop, "contestant": "fovea_bus", "nbytes": 2_341_920},
    ]
    report = {**ORIGIN, "bench": "bus", "rounds": 2, "count_per_round": 30, "rate_hz": 30.0}
    (tmp_path / "bus.json").write_text(json.dumps({**report, "figures": figures}))

    written = page(tmp_path)

    assert "| payload | fovea | zenoh, bytes |" in written
    assert "| 0.066 MB | 0.25 / 1.50 | 0.25 / 1.50, 3 lost |" in written
    assert "| 2.3 MB | 0.25 / 1.50 | – |" in written


def test_a_hop_without_its_figures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bus.json").write_text(json.dumps({**ORIGIN, "bench": "bus", "figures": [{}]}))

    with pytest.raises(ResultError, match=r"^bus\.json: "):
        page(tmp_path)


BY_BUDGET = TABLE | {
    "columns": ["target", "budget", "**foveated** (95 %)", "in ROI", "context", "− context"],
    "rows": [["ball", "1/4", "**.6** (.5–.7)", ".9", ".4, .1", "+.2"],
             ["ball", "1/8", ".5", ".8", "", "+.1"]],
}  # fmt: skip


def test_a_table_by_budget_gives_a_curve_for_each_strategy() -> None:
    found = curves_of(read_table(Path("sample.json"), json.dumps(BY_BUDGET).encode()))

    assert [(r["budget"], r["strategy"], r["iou"], r["ci95"]) for r in found] == [
        ("1/4", "foveated", 0.6, [0.5, 0.7]),
        ("1/4", "context", 0.4, None),
        ("1/8", "foveated", 0.5, None),
    ]


def test_plots_are_drawn_beside_their_files_and_shown_but_those_of_a_bench_are_kept(
    tmp_path: Path,
) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "own.png").write_bytes(b"its bench drew it")
    rule = {"policy": "pursuit", "target": "ball", "without": "all rules",
            "share in the ROI: gained without": "", "IoU: gained without": ""}  # fmt: skip
    gained = {"without": "search", "share in the ROI: gained without": "-0.1 (-0.2 .. +0.1)",
              "IoU: gained without": "+0.0"}  # fmt: skip
    folder_of(
        tmp_path, sample=BY_BUDGET, own=BY_BUDGET | {"id": "own", "plot": "own.png"},
        plain=TABLE | {"id": "plain"},
        left_out=ORIGIN | {"bench": "rules", "rows": [rule, rule | gained]},
        none_left_out=ORIGIN | {"bench": "rules", "rows": [rule]},
    )  # fmt: skip

    given_ = ["--plots", "--folder", str(tmp_path), "--out", str(tmp_path / "page.md")]
    result = CliRunner().invoke(main, given_)

    assert result.output.startswith("sample.png: drawn\nleft_out.png: drawn\n")
    assert (tmp_path / "own.png").read_bytes() == b"its bench drew it"
    assert sorted(p.name for p in tmp_path.glob("*.png")) == [
        "left_out.png", "own.png", "sample.png"
    ]  # fmt: skip
    shown = re.findall(r"!\[.*?\]\(results/(.*?)\)", (tmp_path / "page.md").read_text())
    assert sorted(shown) == ["left_out.png", "own.png", "sample.png"]
