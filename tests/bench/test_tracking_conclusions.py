"""An evaluation ends with sentences that claim no more than the figures show."""

from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console

from bench.tracking.conclusions import ALONE, sentences
from bench.tracking.evaluate import command
from bench.tracking.tables import PAPER, asked_rows, markdown, table

WIDTHS = (50, 80, 120)


def row(target: str, strategy: str, budget: str = "1/8", **told: Any) -> dict[str, Any]:
    plain = {"iou": 0.512, "ci95": None, "pixels": 0.125, "starts": 4, "frames": 90, "clips": 1}
    names = {"clip": "c", "target": target, "strategy": strategy, "budget": budget}
    return names | plain | told


def pair(difference: float | None, against: str, **told: Any) -> dict[str, Any]:
    plain = {"target": "ball", "budget": "1/8", "strategy": "foveated", "ci95": None, "clips": 1}
    return plain | {"difference": difference, "against": against} | told


def report(*pairs: dict[str, Any], **told: Any) -> dict[str, Any]:
    plain = {"clips": ["c"], "targets": ["ball"], "states": False, "rows": [row("ball", "spatial")]}
    return plain | {"paired": list(pairs)} | told


def printed(found: dict[str, Any], width: int = 80) -> str:
    target = StringIO()
    Console(file=target, width=width).print(table(found))
    return target.getvalue()


def test_of_one_clip_a_difference_is_indicative_and_the_missing_interval_is_explained() -> None:
    told = sentences(report(pair(0.0131, "spatial"), pair(-0.02, "oracle"), pair(1e-5, "full")))

    assert told == [
        "ball at 1/8 of the pixels: foveated +0.013 over spatial; -0.020 under oracle; "
        "+0.000 against full, one clip, indicative",
        "No interval is given: frames of one clip depend on one another, and other clips may show "
        "the opposite.",
    ]


@pytest.mark.parametrize(
    ("ends", "judged"),
    [
        ([0.002, 0.024], "(+0.002 to +0.024, excludes zero)"),
        ([-0.03, -0.001], "(-0.030 to -0.001, excludes zero)"),
        ([-0.002, 0.024], "(-0.002 to +0.024, includes zero)"),
        ([0.0, 0.024], "(+0.000 to +0.024, includes zero)"),
    ],
)
def test_of_several_clips_the_sentence_states_whether_the_interval_excludes_zero(
    ends: list[float], judged: str
) -> None:
    told = sentences(report(pair(0.013, "spatial", ci95=ends, clips=30)))

    assert told[0].endswith(f"+0.013 over spatial {judged}, 30 clips")
    assert told[1] == "The interval is of 95 %, paired, by Student's t over whole clips."


def test_over_few_clips_the_missing_interval_is_explained() -> None:
    few, many = pair(0.1, "spatial", clips=3), pair(0.1, "full", ci95=[0.05, 0.2], clips=8)

    told = sentences(report(few))
    mixed = sentences(report(few, many))

    assert told[-1] == "No interval is given: over fewer than 6 clips none holds its level."
    assert "3 clips" in told[0]
    assert "3 to 8 clips" in mixed[0]
    assert mixed[-1].startswith("Where there are enough clips, the interval is of 95 %")


def test_figures_of_a_clip_of_development_are_called_so() -> None:
    told = sentences(report(pair(0.1, "spatial"), development=["SNMOT-116a"]))

    assert told[-1].startswith("SNMOT-116a was looked at while rules and thresholds were chosen")


def test_nothing_is_concluded_where_nothing_is_compared() -> None:
    assert sentences(report()) == [ALONE]
    assert sentences(report(pair(None, "spatial"))) == [ALONE]
    assert sentences(report(pair(0.1, "spatial", target="ball, free"))) == [ALONE]


def test_only_targets_that_were_asked_for_have_rows_and_states_only_if_asked_for() -> None:
    rows = [
        row(name, "spatial") for name in ("ball", "ball, free", "ball, free or still", "player")
    ]

    plain = asked_rows(report(rows=rows))
    states = asked_rows(report(rows=rows, states=True))
    several = asked_rows(report(rows=rows, clips=["c", "d"]))

    assert [each["target"] for each in plain] == ["ball"]
    assert [each["target"] for each in states] == ["ball", "ball, free", "ball, free or still"]
    assert several == []  # rows of single clips are in the report alone


def test_the_papers_column_is_marked_as_other_data() -> None:
    found = report(rows=[row("ball", "spatial", paper=0.122)])

    text, lines = printed(found), markdown(found).splitlines()

    assert PAPER == "paper (other data)"
    assert PAPER in text
    assert "0.122" in text
    assert f"| {PAPER} |" in lines[0]
    assert PAPER not in printed(report())


def test_the_table_is_not_markdown_and_leaves_out_columns_without_figures() -> None:
    text = printed(report())

    assert "|" not in text
    assert "95 %" not in text
    assert text.split()[:4] == ["target", "budget", "strategy", "IoU"]


@pytest.mark.parametrize("width", WIDTHS)
def test_a_terminal_of_any_width_shows_every_word_of_the_table(width: int) -> None:
    whole = row(
        "ball, free or still", "foveated, ROI alone", ci95=[0.251, 0.498], paper=0.283,
        iou_all_frames=0.331, roi_coverage=0.987,
    )  # fmt: skip

    text = printed(report(rows=[whole], states=True), width)

    assert max(map(len, text.splitlines())) <= width
    for word in ("1/8", "0.512", "0.251–0.498"):
        assert word in text
    assert "…" not in text


def test_markdown_holds_intervals_differences_and_sentences() -> None:
    one = row("ball", "foveated", ci95=[0.4, 0.6], clips=30)
    found = report(pair(0.013, "spatial", ci95=[0.002, 0.024], clips=30), rows=[one])

    lines = markdown(found).splitlines()

    assert "| ball | 1/8 | foveated | 0.512 | 0.400–0.600 | 0.1250 | 4 | 90 |" in lines
    assert "| ball | 1/8 | foveated | spatial | +0.013 | +0.002 – +0.024 |" in lines
    assert [line for line in lines if line.startswith("- ")] == [
        f"- {sentence}" for sentence in sentences(found)
    ]


@pytest.mark.lengthy
def test_markdown_is_printed_instead_of_the_table_when_asked_for(tmp_path: Path) -> None:
    words = [
        *("--data", "procedural:70003", "--clips", "1", "--frames", "1-10", "--jobs", "1"),
        *("--strategies", "spatial", "--budgets", "1/8", "--targets", "ball"),
        *("--cue", "none"),
        *("--tracker", "correlation", "--markdown", "-", "--work", str(tmp_path)),
    ]

    done = CliRunner().invoke(command, words, catch_exceptions=False)

    assert done.exit_code == 0
    assert done.stdout.startswith("| target | budget | strategy | IoU |")
    assert not Path("-").exists()
