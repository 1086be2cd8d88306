"""Units of an evaluation are identified by everything that their figures depend on."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName, read
from bench.tracking.episode import Rules
from bench.tracking.key import clip_key, key
from bench.tracking.stock import Stock
from bench.tracking.store import Draft, Unit, forget_damaged, units
from bench.tracking.units import cut, measured
from pipeline.errors import DriverError
from tests.drivers.sequences import write_sequence

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "learned.yaml"


def keyed(graph: Path = GRAPH, strategy: str = "foveated", *changes: str) -> str:
    case = Case(strategy=strategy, budget="1/8", name="", rules=Rules(), changes=changes)
    return key(case, Protocol(graph=str(graph), frames=(1, 9), kinds=("ball",)))


def test_other_weights_make_another_unit(tmp_path: Path) -> None:
    weights, keys = tmp_path / "policy.onnx", []
    for content in (b"a", b"b", b"a"):
        weights.write_bytes(content)
        keys.append(keyed(GRAPH, "foveated", f"policy.weights={weights}"))

    assert keys[0] == keys[2] != keys[1]


def test_the_path_of_weights_makes_no_other_unit(tmp_path: Path) -> None:
    places = [tmp_path / name for name in ("policy.onnx", "copy.onnx")]
    for place in places:
        place.write_bytes(b"a")

    one, other = (keyed(GRAPH, "foveated", f"policy.weights={place}") for place in places)

    assert one == other


def test_other_settings_make_another_unit_and_another_path_of_the_graph_does_not(
    tmp_path: Path,
) -> None:
    copy, other = tmp_path / "copy.yaml", tmp_path / "other.yaml"
    copy.write_text(GRAPH.read_text() + "# a comment\n")
    other.write_text(GRAPH.read_text().replace("target: ball", "target: referee"))

    assert keyed(copy) == keyed() != keyed(other)
    assert keyed(other, "spatial") == keyed(GRAPH, "spatial")


def test_other_code_of_a_part_makes_another_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, graph = tmp_path / "seer.py", tmp_path / "tracking.yaml"
    graph.write_text(
        GRAPH.read_text().replace("operators.policy:LearnedPolicy", "seer:LearnedPolicy")
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    code.write_text("from operators.policy import LearnedPolicy\n")
    before, plain = keyed(graph), keyed(graph, "spatial")

    code.write_text("from operators.policy import LearnedPolicy  # and more\n")

    assert keyed(graph) != before
    assert keyed(graph, "spatial") == plain


@pytest.mark.parametrize("strategy", ["foveated", "spatial"])
def test_a_unit_depends_on_the_code_that_its_operators_share(strategy: str) -> None:
    for module in ("boxes", "colours", "inference", "messages", "pixel_formats"):
        assert f"code of pipeline.{module}" in keyed(GRAPH, strategy)


def test_an_unfinished_unit_keeps_its_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.tracking.store.KEEP_S", 0.0)
    Draft(tmp_path / "unit.part").add(3, {"start": 8, "iou": [0.5]})

    again = Draft(tmp_path / "unit.part")

    assert again.known(3, 8) == {"start": 8, "iou": [0.5]}
    assert again.known(3, 16) is again.known(2, 8) is None
    again.finish([], tmp_path / "unit.json")
    assert [path.name for path in tmp_path.iterdir()] == ["unit.json"]


def row(strategy: str = "spatial", budget: str = "1/4", **more: Any) -> Case:
    changes = ("tracker.lost_score=0.35",)
    given = {"name": strategy, "rules": Rules(), "changes": changes, **more}
    return Case(strategy=strategy, budget=budget, **given)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Write a sequence of a ball of 8 pixels that moves by one pixel per frame."""
    gt = "\n".join(f"{frame},1,{10 + frame},10,8,8,1,-1,-1,-1" for frame in range(1, 17))
    game = "[Sequence]\nnum_tracklets=1\ntrackletID_1= ball;1\n"
    return write_sequence(tmp_path / "clip", gt=gt, gameinfo=game, frames=16)


def follow(recorded: Path, work: Path, *rows: Case) -> list[Unit]:
    protocol = Protocol(graph=str(GRAPH), frames=(1, 16), kinds=("ball",))
    return measured([ClipName(folder=str(recorded))], rows or (row(),), protocol, work, jobs=1)


@pytest.mark.lengthy
def test_an_interrupted_unit_continues_within_a_clip(recorded: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    (whole,) = follow(recorded, work)
    (file,) = work.iterdir()
    first, *others = whole["episodes"]
    assert others
    marked = {**first, "iou": [0.125] * len(first["iou"])}
    file.with_suffix(".part").write_text(
        json.dumps({f"{whole['target']} {first['start']}": marked})
    )
    file.unlink()

    (again,) = follow(recorded, work)

    assert again["episodes"] == [marked, *others]
    assert [path.name for path in work.iterdir()] == [file.name]


@pytest.mark.parametrize("left", ["", '[{"clip": "clip", "case"', "{}", "\0" * 8])
def test_files_of_units_that_a_crash_damaged_are_removed(tmp_path: Path, left: str) -> None:
    damaged, whole = tmp_path / "damaged.json", tmp_path / "whole.json"
    damaged.write_text(left)
    whole.write_text("[]")

    forget_damaged([damaged, whole, tmp_path / "absent.json"])

    assert [path.name for path in tmp_path.iterdir()] == ["whole.json"]
    assert units(whole) == []


@pytest.mark.lengthy
def test_damaged_files_are_measured_again(recorded: Path, tmp_path: Path) -> None:
    whole = follow(recorded, tmp_path / "work")
    (file,) = (tmp_path / "work").iterdir()
    written = file.read_text()
    file.write_text(written[:40])
    file.with_suffix(".part").write_text("")

    again = follow(recorded, tmp_path / "work")

    assert again == whole
    assert [path.read_text() for path in (tmp_path / "work").iterdir()] == [written]


def test_the_bar_counts_units_that_were_finished_before(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    follow(recorded, tmp_path / "work")
    capsys.readouterr()

    follow(recorded, tmp_path / "work")

    last = capsys.readouterr().err.split("\r")[-1]
    assert "1/1" in last


def test_warnings_of_the_parts_are_kept_and_counted(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    follow(recorded, tmp_path, row("foveated", "1/8"))

    told = (tmp_path / "warnings.log").read_text().splitlines()
    assert told
    assert told[0].startswith("clip: policy.prompt_box: expected a track at")
    error = capsys.readouterr().err
    assert "prompt_box" not in error
    assert error.endswith(f"{len(told)} warnings: {tmp_path / 'warnings.log'}\n")


@pytest.mark.lengthy
def test_tracks_of_one_detector_are_not_used_for_another() -> None:
    found = []
    with Stock(read(ClipName(seed=70_003), (1, 3)), GRAPH) as stock:
        for more in ("saliency.confidence=0.25", "saliency.confidence=0.999"):
            case = row("foveated", "1/8", changes=(more,), policy="pursuit")
            found.append(stock.loop(case).tracks[2])

    assert [bool(len(tracks.ids)) for tracks in found] == [True, False]


def test_a_clip_is_identified_by_its_truth_and_pictures_not_by_its_path(
    recorded: Path, tmp_path: Path
) -> None:
    def known(folder: Path) -> str:
        return clip_key(ClipName(folder=str(folder)), (1, 15))

    copy = tmp_path / "elsewhere" / "clip"
    shutil.copytree(recorded, copy, copy_function=shutil.copyfile)
    before, picture = known(recorded), recorded / "img1" / "000002.jpg"
    assert known(copy) == before
    (recorded / "img1" / "000016.jpg").write_bytes(b"not looked at")
    assert known(recorded) == before

    turned = bytearray(picture.read_bytes())
    turned[-9] ^= 1
    picture.write_bytes(turned)
    (copy / "gt" / "gt.txt").write_text("1,1,10,10,8,8,1,-1,-1,-1\n")

    assert len({before, known(recorded), known(copy)}) == 3
    picture.unlink()
    with pytest.raises(DriverError, match=r"000002\.jpg: cannot be read"):
        known(recorded)


def test_a_clip_is_divided_if_processes_would_be_idle() -> None:
    clips = [ClipName(seed=seed) for seed in range(3)]
    rows = [
        row(strategy, budget, name=f"{strategy} {context}", rules=Rules(context=context))
        for strategy in ("oracle", "foveated", "centred")
        for budget in ("1/4", "1/8")
        for context in (True, False)
    ]
    left = {clip: [(case, Path(f"{clip} {case}")) for case in rows] for clip in clips}

    first, second, *parts = cut(left, 2)

    assert (first, second) == ((clips[0], tuple(left[clips[0]])), (clips[1], tuple(left[clips[1]])))
    assert [clip for clip, _ in parts] == [clips[2]] * 2
    budgets = [{case.budget for case, _ in work} for _, work in parts]
    assert budgets == [{"1/4"}, {"1/8"}]
    assert sorted(path for _, work in parts for _, path in work) == sorted(
        path for _, path in left[clips[2]]
    )
    assert len(cut(left, 1)) == 3
    assert cut({clips[0]: []}, 2) == []


def test_cases_that_share_their_windows_stay_together() -> None:
    rows = [row("oracle", name=str(c), rules=Rules(context=c)) for c in (True, False)]

    (only,) = cut({ClipName(seed=1): [(case, Path(case.name)) for case in rows]}, 8)

    assert [case for case, _ in only[1]] == rows
