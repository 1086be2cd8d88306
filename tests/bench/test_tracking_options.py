"""Options of an evaluation are parsed, or refused before any work."""

from fractions import Fraction
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.tracking.cases import cases
from bench.tracking.clip import ClipName
from bench.tracking.evaluate import command
from bench.tracking.options import ALL, WHOLE, Options, options_of
from tests.drivers.sequences import write_sequence

GAME = "[Sequence]\nnum_tracklets=1\ntrackletID_1= ball;1\n"


def read(*words: str) -> Options:
    with command.make_context("eval", ["--data", "procedural", *words]) as context:
        return options_of(context.params)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--strategies", "magic"], "strategies: expected foveated, centred"),
        (["--targets", "coach"], "targets: expected ball"),
        (["--policy", "none.onnx"], "policy: expected an ONNX file or pursuit, got none.onnx"),
        (["--clips", "0"], "clips: must be at least 1, got 0"),
        (["--clips", "-3"], "clips: must be at least 1, got -3"),
        (["--jobs", "0"], "jobs: must be at least 1, got 0"),
        (["--every", "0"], "every: must be at least 1, got 0"),
        (["--every", "-1"], "every: must be at least 1, got -1"),
        (["--players", "0"], "players: must be at least 1, got 0"),
        (["--longest", "0"], "longest: must be at least 1, got 0"),
        (["--seed", "-1"], "seed: must be at least 0, got -1"),
        (["--replan", "4,0"], "replan: must be at least 1, got 0"),
        (["--delay", "-2"], "delay: must be at least 0, got -2"),
        (["--delay", "60"], "delay: plans reach 16 frames"),
        (["--delay", "soon"], "delay: expected whole numbers"),
        (["--replace", "luck"], "replace: expected detections"),
        (["--tracker", "magic"], "tracker: expected correlation, template, vittrack"),
        (["--frames", "5-2"], "frames: expected A-B"),
        (["--frames", "0-9"], "frames: expected A-B"),
        (["--frames", "1"], "frames: expected A-B with B after A, got 1-1"),
        (["--plot", "plot.xyz"], "plot: expected .png, .pdf, .svg at the end, got plot.xyz"),
        (["--plot", "plot"], "plot: expected .png, .pdf, .svg at the end, got plot"),
        (["--data", "/nowhere"], "/nowhere: expected a folder of SoccerNet sequences"),
        (["--clips", "1001"], "clips: must be at most 1000, got 1001"),
        (["--report", ""], "report: expected a file, got ."),
        (["--report", "-"], "report: expected a file, got -; --markdown - prints"),
        (["--missed", ".3"], "missed: expected only with --many, got 0.3 without"),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(words: list[str], said: str) -> None:
    result = CliRunner().invoke(command, ["--data", "procedural", *words])

    assert result.exit_code == 2
    assert result.output.startswith(f"fovea eval tracking: {said}")
    assert len(result.output.splitlines()) == 1


@pytest.mark.parametrize(
    "words",
    [
        *(["--targets", "ball"], ["--players", "2"], ["--every", "4"], ["--longest", "9"]),
        *(["--tracker", "vittrack"], ["--sees", "roi"], ["--cue", "each"]),
        *(["--protocol", "long"], ["--states"], ["--replan", "4"], ["--prediction", "hold"]),
        *(["--replace", "tracker"], ["--seed", "3"], ["--plot", "plot.png"]),
    ],
)
def test_what_the_score_of_many_objects_does_not_depend_on_is_refused(words: list[str]) -> None:
    result = CliRunner().invoke(command, ["--data", "procedural", "--many", *words])

    assert result.exit_code == 2
    name = words[0].removeprefix("--")
    assert result.output == (
        f"fovea eval tracking: {name}: expected no --{name} with --many, which does not depend on "
        "it\n"
    )


def test_the_score_of_many_objects_takes_what_it_depends_on() -> None:
    used = ("--frames", "1-9", "--clips", "2", "--budgets", "1/8", "--strategies", "context,greedy")
    more = ("--delay", "0,13", "--missed", ".3", "--policy", "pursuit", "--graph", "many")

    found = read(
        "--many", *used, *more, "--set", "identity.likeness=.9", "--report", "r.json", "--jobs", "4"
    )

    assert (found.delay, found.missed, found.policy) == ((0, 13), 0.3, {"": "pursuit"})
    assert read("--many").strategies == ALL


@pytest.mark.parametrize("output", ["report", "markdown", "plot", "work"])
def test_an_output_that_cannot_be_written_is_refused_before_anything_is_measured(
    output: str, tmp_path: Path
) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder.png"
    file.touch()
    folder.mkdir()
    wrong = [file / "plot.png", *([file] if output == "work" else [folder])]

    for path in wrong:
        words = ["--data", "procedural", "--tracker", "correlation", f"--{output}", str(path)]
        if output != "work":
            words += ["--work", str(tmp_path / "work")]
        result = CliRunner().invoke(command, words)
        assert result.exit_code == 2
        assert result.output.startswith(f"fovea eval tracking: {output}: ")
        assert len(result.output.splitlines()) == 1


def test_frames_that_a_sequence_does_not_have_are_refused(tmp_path: Path) -> None:
    gt = "\n".join(f"{frame},1,10,10,8,8,1,-1,-1,-1" for frame in (1, 2, 3))
    folder = write_sequence(tmp_path / "clip", gt=gt, gameinfo=GAME)
    words = ["--data", str(folder), "--frames", "1-9999", "--work", str(tmp_path / "work")]

    result = CliRunner().invoke(command, [*words, "--tracker", "correlation"])

    assert result.exit_code == 2
    assert "frames: clip has 1 to 3, got 1-9999" in result.output
    assert not (tmp_path / "work").exists()


def test_an_evaluation_without_a_visible_target_is_an_error(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path / "clip", gt="", gameinfo=GAME)
    words = ["--data", str(folder), "--work", str(tmp_path / "work"), "--strategies", "spatial"]

    result = CliRunner().invoke(
        command,
        [*words, "--budget", "1/4", "--targets", "ball", "--tracker", "correlation", "--jobs", "1"],
    )

    assert result.exit_code == 2
    assert result.output.splitlines()[-1].endswith(
        f"{folder}: nothing to follow: no ball can be seen in the frames asked for"
    )
    assert "| target |" not in result.output


def test_an_evaluation_of_nothing_that_can_be_scored_is_an_error(tmp_path: Path) -> None:
    words = ["--data", "procedural", "--clips", "1", "--frames", "1-12", "--jobs", "1"]
    words += ["--work", str(tmp_path / "work"), "--tracker", "correlation", "--targets", "ball"]

    result = CliRunner().invoke(command, [*words, "--strategies", "temporal", "--budget", "1/64"])

    assert result.exit_code == 2
    assert result.output.splitlines()[-1].endswith(
        "procedural: no frame can be scored of temporal, no cue at 1/64: expected longer clips "
        "(--frames)"
    )


def test_values_that_are_named_twice_count_once() -> None:
    found = read(
        *(
            "--strategies",
            "centred,centred",
            "--budgets",
            "1/8,2/16,.125",
            "--targets",
            "ball,ball",
        ),
        *("--delay", "0,0", "--replan", "4,1,4", "--policy", "pursuit", "--policy", "pursuit"),
        *("--replace", "association+detections", "--replace", "detections+association"),
    )

    assert found.strategies == ("centred",)
    assert found.budgets == (Fraction(1, 8),)
    assert found.targets == ("ball",)
    assert (found.delay, found.replan) == ((0,), (4, 1))
    assert found.policy == {"": "pursuit"}
    assert found.replace == (("detections", "association"),)


def test_options_have_defaults_ranges_and_names() -> None:
    assert read().frames == WHOLE
    assert read().strategies == ALL
    assert read("--frames", "251-375").frames == (251, 375)
    assert read("--budget", "1/4").budgets == read("--budgets", "1/4").budgets == (Fraction(1, 4),)
    policies = read("--policy", "a=pursuit", "--policy", "b=pursuit").policy
    assert policies == {"a": "pursuit", "b": "pursuit"}


def test_only_strategies_that_are_asked_for_have_rows() -> None:
    found = cases(read("--strategies", "foveated,spatial", "--budgets", "1/8"))

    assert [case.name for case in found] == ["foveated, no cue", "spatial, no cue"]
    assert read().sees == "both"
    assert not read().states


def test_late_and_rare_plans_hold_for_the_round_robin_as_for_the_policy_and_for_no_other() -> None:
    asked = ("--delay", "0,13", "--replan", "4", "--prediction", "hold", "--budgets", "1/8")
    found = cases(read("--strategies", "foveated,round_robin,oracle,spatial", *asked))

    told = {s: [c for c in found if c.strategy == s] for s in ("foveated", "round_robin")}
    assert [case.rules for case in told["round_robin"]] == [c.rules for c in told["foveated"]]
    assert [case.name for case in told["round_robin"]] == [
        f"round_robin, delay {delay}, Ta 4, no prediction, no cue" for delay in (0, 13)
    ]
    others = [case for case in found if case.strategy in ("oracle", "spatial")]
    assert [case.name for case in others] == ["oracle, no cue", "spatial, no cue"]
    assert [(c.rules.delay, c.rules.replan, c.rules.prediction) for c in others] == [
        (0, 1, True)
    ] * 2


def test_two_policies_of_one_name_are_refused(tmp_path: Path) -> None:
    files = [tmp_path / run / "policy.onnx" for run in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        file.touch()

    for words in (files, [f"x={file}" for file in files]):
        policies = [word for each in words for word in ("--policy", str(each))]
        result = CliRunner().invoke(command, ["--data", "procedural", *policies])
        assert result.exit_code == 2
        assert "give each a name of its own: NAME=FILE" in result.output


def test_every_strategy_has_a_row_for_each_budget_and_full_has_one() -> None:
    found = cases(read("--budgets", "1/8,1/4", "--tracker", "correlation", "--sees", "both"))

    assert {(case.strategy, case.budget) for case in found} == {
        ("full", "1"),
        *((s, b) for s in ALL if s not in ("full", "pursuit") for b in ("1/8", "1/4")),
    }
    assert [(c.name, c.policy) for c in found if c.name.startswith("pursuit")] == [
        ("pursuit, no cue", "pursuit")
    ] * 2
    assert len(found) == 2 * len(ALL) - 1


def test_a_clip_has_its_folders_name_wherever_it_is_called_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "SNMOT-1").mkdir()
    monkeypatch.chdir(tmp_path / "SNMOT-1")

    assert str(ClipName(folder=".")) == "SNMOT-1"
