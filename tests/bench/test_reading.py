"""Evaluation of the text task."""

import json
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("rapidocr")
pytest.importorskip("PIL")

from bench.reading.clips import clips_of
from bench.reading.evaluate import GRAPH, command, key, markdown_of, told
from bench.reading.plot import plot
from bench.reading.rows import ALL, Row, rows_of
from bench.reading.trial import Job, Outcome, needed, plan_of, sensor_of, trial
from pipeline import SettingsError
from pipeline.errors import DriverError, RunError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay

HD = (1280, 720)
EIGHTH = Fraction(1, 8)


def job(strategy: str, frames: int = 2, *changes: str, seed: int = 50_000) -> Job:
    budget = Fraction(1) if strategy == "full" else EIGHTH
    (clip,) = clips_of("road", count=1, frames=frames, seed=seed)
    row = Row(strategy=strategy, budget=budget)
    return Job(graph=str(GRAPH), changes=changes, frames=frames, row=row, clip=clip)


def outcome(seed: int, read: int, legible: int = 10) -> Outcome:
    return Outcome(
        clip=str(seed), legible=legible, read=read, nearly=read, waits_s=(0.5,) * read,
        duration_s=6.0, pixels=0.125,
    )  # fmt: skip


def test_every_strategy_reads_what_its_budget_allows() -> None:
    for row in rows_of(["all"], [Fraction(1, 4), EIGHTH, Fraction(1, 16)], HD):
        plan = plan_of(job(row.strategy))
        settings = sensor_of(load(GRAPH, Overlay(changes=row.changes(HD), clock="lockstep")))
        emitted = settings.sampling(HD)
        share = emitted.emitted_px() / (HD[0] * HD[1]) / emitted.interval
        wanted = float(row.budget)
        assert share <= wanted * 1.02, row
        if row.strategy != "context":
            assert share == pytest.approx(wanted, rel=0.05), row
        assert "reader" in {node.name for node in plan.nodes}


def test_rows_without_a_policy_run_the_sensor_and_the_reader_only() -> None:
    names = {node.name for node in plan_of(job("spatial")).nodes}

    assert names == {"capture", "reader"}


def test_a_row_with_a_policy_has_all_that_aims_the_roi() -> None:
    plan = plan_of(job("greedy"))

    names = {node.name for node in plan.nodes}
    assert {"saliency", "association", "policy", "dispatch"} <= names
    assert not {"score", "visualise"} & names
    assert plan.node("policy").operator.endswith(":GreedyReadingPolicy")


def test_what_the_reader_needs_is_kept_whatever_else_a_graph_has() -> None:
    plan = load(GRAPH, Overlay(clock="lockstep"))

    kept = needed(plan, aimed=True)

    for edge in kept.edges:
        assert {edge.source, edge.target} <= {node.name for node in kept.nodes}


def test_other_clips_or_settings_are_measured_anew_and_the_same_are_not() -> None:
    one = key(job("spatial"))

    assert key(job("spatial")) == one
    assert key(job("spatial", 3)) != one
    assert key(job("spatial", 2, "reader.least_score=0.7")) != one
    assert key(job("context")) != one
    assert key(job("spatial", seed=50_007)) == one  # a row's clips are in one file


def test_a_clip_is_played_and_counted() -> None:
    found = trial(job("spatial", 2))

    assert found.legible > 0
    assert 0 <= found.read <= found.nearly <= found.legible
    assert found.pixels == pytest.approx(1 / 8, rel=0.02)
    assert found.duration_s == pytest.approx(0.2)


@pytest.mark.lengthy
def test_what_is_legible_is_the_same_for_every_strategy() -> None:
    counts = {trial(job(name, 9)).legible for name in ("temporal", "context")}

    assert len(counts) == 1


def photographs(folder: Path) -> Path:
    for number in range(2):
        drawn = np.full((360, 640, 3), (30, 60, 120), np.uint8)
        cv2.putText(drawn, "BAKERY", (200, 190), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (250,) * 3, 2)
        cv2.imwrite(str(folder / f"img_{number}.png"), drawn)
        corners = "195,155,360,155,360,195,195,195"
        (folder / f"gt_img_{number}.txt").write_text(f"{corners},BAKERY\n")
    return folder


def test_each_labelled_photograph_of_a_folder_is_a_clip(tmp_path: Path) -> None:
    clips = clips_of(str(photographs(tmp_path)), count=9, frames=3, seed=0)

    outcomes = [trial(replace(job("temporal", 3), clip=clip)) for clip in clips]

    assert [each.clip for each in outcomes] == ["img_0.png", "img_1.png"]
    assert [each.legible for each in outcomes] == [1, 1]
    assert [each.read for each in outcomes] == [1, 1]


def test_the_content_of_a_clip_is_that_of_its_pictures_and_labels(tmp_path: Path) -> None:
    folder = photographs(tmp_path)
    clips = partial(clips_of, str(folder), count=9, frames=3, seed=0)
    before = [clip.content() for clip in clips()]
    assert before == [clip.content() for clip in clips()]

    (folder / "gt_img_0.txt").write_text("195,155,360,155,360,195,195,195,BAKER\n")
    relabelled = [clip.content() for clip in clips()]
    cv2.imwrite(str(folder / "img_1.png"), np.zeros((360, 640, 3), np.uint8))
    repainted = [clip.content() for clip in clips()]

    assert relabelled[0] != before[0]
    assert relabelled[1] == before[1] != repainted[1]
    assert repainted[0] == relabelled[0]


def test_a_photograph_without_a_label_in_its_file_is_passed_over(tmp_path: Path) -> None:
    (photographs(tmp_path) / "gt_img_0.txt").write_text("")

    clips = clips_of(str(tmp_path), count=9, frames=3, seed=0)

    assert [clip.name for clip in clips] == ["img_1.png"]


def test_a_video_goes_with_the_labels_of_its_name_or_the_only_ones(tmp_path: Path) -> None:
    for name in ("1.mp4", "2.mp4", "all.json"):
        (tmp_path / name).touch()
    first, second = clips_of(str(tmp_path), count=9, frames=3, seed=0)
    assert any(change.endswith('all.json"}') for change in second.changes)
    assert first.alike == second.alike

    (tmp_path / "2.json").touch()

    (only,) = clips_of(str(tmp_path), count=9, frames=3, seed=0)
    assert only.name == "2.mp4"


def test_a_video_of_the_original_release_has_a_second_file(tmp_path: Path) -> None:
    (tmp_path / "7.mp4").touch()
    for name in ("boxes.json", "texts.json"):
        (tmp_path / name).touch()
    files = {"labels": "boxes.json", "transcriptions": "texts.json"}
    given = {name: str(tmp_path / file) for name, file in files.items()}

    (clip,) = clips_of(str(tmp_path), count=9, frames=3, seed=0, **given)

    assert f"capture.source_options={json.dumps(given)}" in clip.changes


def test_photographs_of_textocr_have_one_file_of_labels(tmp_path: Path) -> None:
    photographs(tmp_path)
    points = [195, 155, 360, 155, 360, 195, 195, 195]
    document = {
        "imgs": {"a": {"file_name": "train/img_1.png"}},
        "anns": {"a_1": {"image_id": "a", "points": points, "utf8_string": "BAKERY"}},
    }
    labels = tmp_path / "textocr.json"
    labels.write_text(json.dumps(document))

    (clip,) = clips_of(str(tmp_path), count=9, frames=3, seed=0, labels=str(labels))
    found = trial(replace(job("temporal", 3), clip=clip))

    assert (found.clip, found.legible, found.read) == ("img_1.png", 1, 1)


def test_a_folder_without_clips_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=r"expected videos with NAME\.json or one JSON file"):
        clips_of(str(tmp_path), count=9, frames=3, seed=0)


def test_a_share_of_the_pixels_that_is_not_the_budget_is_refused() -> None:
    from bench.reading.trial import check_budget

    with pytest.raises(RunError, match=r"spatial: expected 0\.12500 of the pixels, got 0\.20000"):
        check_budget(Row(strategy="spatial", budget=EIGHTH), 0.2)


def test_differences_are_paired_by_clip() -> None:
    ours, theirs = (Row(strategy=name, budget=EIGHTH) for name in ("foveated", "spatial"))
    clips = range(8)
    outcomes = {
        ours: [outcome(seed, 5 + seed % 3) for seed in clips],
        theirs: [outcome(seed, 3 + seed % 3) for seed in clips],
    }

    row = told(theirs, outcomes)

    low, high = row["to_foveated_ci95"]
    assert row["to_foveated"] == pytest.approx(-0.2)
    assert low == pytest.approx(high)
    assert row["wait_s"] == 0.5


def test_clips_without_a_legible_text_count_for_nothing() -> None:
    row = Row(strategy="spatial", budget=EIGHTH)
    outcomes = [*[outcome(seed, 5) for seed in range(7)], outcome(7, 0, legible=0)]

    assert told(row, {row: outcomes})["read"] == 0.5


def test_few_clips_have_no_interval_and_the_report_is_json(tmp_path: Path) -> None:
    row = Row(strategy="spatial", budget=EIGHTH)

    figures = told(row, {row: [outcome(seed, 5) for seed in range(3)]})

    assert figures["ci95"] is None
    json.dumps(figures, allow_nan=False)
    plot([figures], tmp_path / "budgets.svg")
    assert "spatial" in (tmp_path / "budgets.svg").read_text()
    assert markdown_of([figures]).startswith("| strategy |")


def test_a_part_that_knows_the_truth_takes_its_place() -> None:
    rows = rows_of(["foveated"], [EIGHTH], HD, replaced=["detections", "reader"])
    plans = {row.name: plan_of(replace(job("foveated"), row=row)) for row in rows}

    true = plans["foveated, true detections"].node("saliency").operator
    assert true == "bench.reading.known:TrueDetections"
    assert plans["foveated, true reader"].node("reader").operator.endswith(":TrueReader")
    assert plans["foveated"].node("reader").operator.endswith(":Reader")


def test_with_true_detections_and_a_true_reader_a_clip_is_played() -> None:
    for row in rows_of(["foveated"], [EIGHTH], HD, replaced=["detections", "reader"])[1:]:
        found = trial(replace(job("foveated", 6), row=row))

        assert found.legible > 0, row


def test_an_input_of_the_policy_is_left_out() -> None:
    row = rows_of(["foveated"], [EIGHTH], HD, without=["percept"])[1]

    plan = plan_of(replace(job("foveated"), row=row))

    assert row.name == "foveated without percept"
    assert "percept" not in plan.inputs("policy")
    assert "tracks" in plan.inputs("policy")


def test_another_policy_takes_the_place_of_the_graphs_own(tmp_path: Path) -> None:
    weights = str(tmp_path / "reading.onnx")
    rows = rows_of(["foveated", "greedy"], [EIGHTH], HD, policy=weights)

    settings = plan_of(replace(job("foveated"), row=rows[0])).node("policy")

    assert (settings.operator, settings.settings) == (
        "operators.policy:ReadingPolicy",
        {"weights": weights},
    )
    assert rows[1].policy == ""


def test_the_table_has_the_papers_figures_beside_ours() -> None:
    row = Row(strategy="foveated", budget=EIGHTH)

    text = markdown_of([told(row, {row: [outcome(seed, 5) for seed in range(8)]})])

    assert "| 0.264 |" in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--strategies", "guess"], "strategies: expected all, full"),
        (["--budgets", "2/1"], "budgets"),
        (["--clips", "0"], "clips: expected 1 to"),
        (["--data", "nowhere"], "data: expected road or a folder, got nowhere"),
        (["--labels", "t.json"], "labels: expected a file beside --data FOLDER, got t.json"),
        (["--data", ".", "--labels", "no.json"], "labels: expected a JSON file, got no.json"),
        (["--policy", "no.onnx"], "policy: expected an ONNX file, got no.onnx"),
        (["--replace", "eyes"], "replace: expected detections, reader, got eyes"),
        (["--without", "tracks"], "without: expected features, percept, roi, got tracks"),
        (["--frames", "0"], "frames: expected 1 to"),
        (["--plot", "picture.txt"], "plot: expected .png, .pdf, .svg at the end"),
        (["--report", "/dev/null"], "report: expected a file that can be written, got /dev/null"),
        (["--markdown", "/"], "markdown: expected a file that can be written, got /"),
        (["--graph", "graphs/tracking.yaml"], "node reader, got none"),
        (
            ["--strategies", "exposure", "--budgets", "1/64", "--frames", "40"],
            "frames: exposure at 1/64 needs at least 64, got 40",
        ),
    ],
)
def test_wrong_options_are_refused_in_a_sentence(
    tmp_path: Path, words: list[str], sentence: str
) -> None:
    result = CliRunner().invoke(command, [*words, "--work", str(tmp_path)])

    assert result.exit_code != 0
    assert sentence in result.output
    assert "Traceback" not in result.output


@pytest.mark.lengthy
def test_an_interrupted_evaluation_goes_on_where_it_was(tmp_path: Path) -> None:
    words = ["--strategies", "context", "--budgets", "1/8", "--frames", "2", "--jobs", "1"]
    words += ["--seed", "50000", "--work", str(tmp_path / "work")]
    assert CliRunner().invoke(command, [*words, "--clips", "1"]).exit_code == 0
    (path,) = (tmp_path / "work").glob("*.json")
    first = json.loads(path.read_text())
    (kept,) = first.values()
    kept["legible"] = 77
    path.write_text(json.dumps(first))

    report = tmp_path / "report.json"
    result = CliRunner().invoke(command, [*words, "--clips", "2", "--report", str(report)])

    assert result.exit_code == 0, result.output
    told_of = json.loads(report.read_text())
    (row,) = told_of["rows"]
    assert row["legible"] > 77
    assert told_of["bench"] == "reading"  # whatever the file's name, it has its place in RESULTS.md


def test_all_strategies_are_known_to_the_table() -> None:
    assert {row.strategy for row in rows_of(["all"], [EIGHTH], HD)} == set(ALL)
    with pytest.raises(SettingsError, match="strategies: expected all"):
        rows_of(["none"], [EIGHTH], HD)
