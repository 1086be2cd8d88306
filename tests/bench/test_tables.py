"""The evaluation accepts every study of the tables, which hold all studies of a folder."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.tables import NAMES, main, studies, together
from bench.tracking.cases import NO_CUE, ROI_ALONE
from bench.tracking.evaluate import asked, command
from bench.tracking.options import options_of
from bench.tracking.replaced import PARTS
from operators.policy.network import SHIPPED
from tests.drivers.sequences import write_sequence

CLIPS = {"budgets": 30, "late": 6, "late-hold": 6, "far": 2, "far-hold": 2}


@pytest.mark.parametrize("quick", [False, True])
def test_the_evaluation_accepts_every_study(quick: bool, tmp_path: Path) -> None:
    weights = tmp_path / "policy.onnx"
    weights.touch()
    whole = f"{weights}"
    found = studies(30, "", (f"no-roi={weights}",), (whole,), far=whole, quick=quick)

    rows = {}
    for name, words in found.items():
        with command.make_context(name, [*words, "--tracker", "correlation"]) as context:
            cases, _, clips = asked(options_of(context.params))
        assert len(clips) == (1 if quick else CLIPS.get(name, 10))
        rows[name] = [case.name.removesuffix(NO_CUE).removesuffix(ROI_ALONE) for case in cases]

    real = {name for name in NAMES if name.endswith("soccernet")}
    assert set(found) == set(NAMES) - real - {"run-time", "all-tasks"}
    delays, replans, budgets = 3, 3, 3
    assert len(set(rows["late"])) == delays * replans
    assert len(rows["late"]) == len(set(rows["late"])) * budgets
    assert len(rows["late-hold"]) == delays * replans
    assert len(rows["far"]) == 2 * (replans + 1) * budgets  # Ta 180 too, as the paper has it
    assert {f"foveated + true {part}" for part in PARTS} < set(rows["limits"])
    assert {"foveated whole", "foveated no-roi", "foveated pursuit"} < set(rows["ablation"])


@pytest.mark.parametrize("quick", [False, True])
def test_real_footage_is_a_study_if_it_is_given(quick: bool, tmp_path: Path) -> None:
    game = "[Sequence]\nnum_tracklets=0\n"
    info = "[Sequence]\nframeRate=25\nseqLength=24\nimWidth=1920\nimHeight=1080\n"
    folder = write_sequence(tmp_path / "clip", gt="", gameinfo=game, frames=24, info=info)
    weights = tmp_path / "policy.onnx"
    weights.touch()
    found = studies(30, str(folder), (), (), far=str(weights), quick=quick)

    for name in (name for name in NAMES if name.endswith("soccernet")):
        with command.make_context(name, [*found[name], "--tracker", "correlation"]) as context:
            cases, protocol, clips = asked(options_of(context.params))
        assert [clip.folder for clip in clips] == [str(folder)]
        assert protocol.frames == ((1, 24) if quick else (1, 0))
        assert cases


def test_a_study_that_lacks_what_it_needs_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["--out", str(tmp_path), "--only", "far"])

    assert result.exit_code == 2
    assert "--only far: needs" in result.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--ablation", "x=/nowhere.onnx"], "ablation: policy: expected an ONNX file or pursuit"),
        (["--far", "/nowhere.onnx"], "far: policy: expected an ONNX file or pursuit"),
        (["--far", str(SHIPPED)], f"far: {SHIPPED}: expected horizon 200"),
        (["--soccernet", "/nowhere"], "soccernet: /nowhere: expected a folder of SoccerNet"),
        (["--clips", "0"], "budgets: clips: must be at least 1, got 0"),
    ],
)
def test_a_study_that_cannot_be_measured_is_refused_before_the_first_begins(
    words: list[str], said: str, tmp_path: Path
) -> None:
    given = ["--out", str(tmp_path), "--tracker", "correlation", *words]

    result = CliRunner().invoke(main, given)

    assert result.exit_code == 2
    assert f"Error: {said}" in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_is_not_there_is_refused_before_a_study_is_looked_at(tmp_path: Path) -> None:
    given = ["--out", str(tmp_path), "--text", "/nowhere.json", "--clips", "0"]

    result = CliRunner().invoke(main, given)

    assert result.exit_code != 0
    assert "Error: /nowhere.json: expected a report of fovea eval" in result.output


def test_eight_players_are_a_study_of_their_own() -> None:
    words = studies(30, "footage", (), ())["players-soccernet"]

    assert words == [
        *("--data", "footage", "--sees", "each"),
        *("--targets", "player", "--players", "8", "--every", "24"),
    ]


def test_tables_hold_every_study_that_lies_in_the_folder(tmp_path: Path) -> None:
    for name in ("budgets", "run-time"):
        (tmp_path / f"{name}.json").write_text('{"rows": []}')
        (tmp_path / f"{name}.md").write_text(f"| {name} |\n")

    together(tmp_path)

    assert set(json.loads((tmp_path / "tables.json").read_text())) == {"budgets", "run-time"}
    text = (tmp_path / "tables.md").read_text()
    assert text.index(NAMES["budgets"]) < text.index("| budgets |") < text.index("| run-time |")
