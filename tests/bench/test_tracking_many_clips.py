"""Clips of `--many` are scored by worker processes; a finished clip is not scored again."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.tracking.evaluate import command, protocol_of
from bench.tracking.many_clips import key_of_many
from bench.tracking.options import options_of

SHORT = ("--many", "--data", "procedural", "--clips", "2", "--frames", "1-3", "--budgets", "1/8")


def key(*words: str) -> str:
    with command.make_context("eval", [*SHORT, *words]) as context:
        options = options_of(context.params)
    return key_of_many(options, protocol_of(options))


def test_what_changes_the_figures_of_a_clip_changes_its_key() -> None:
    keys = [
        key("--strategies", "context"),
        key("--strategies", "context,greedy"),
        key("--strategies", "context", "--missed", ".3"),
        key("--strategies", "context", "--frames", "1-4"),
        key("--strategies", "context", "--set", "association.iou_gate=.2"),
        key("--strategies", "context", "--graph", "many_broadcast"),
        key("--strategies", "foveated", "--policy", "pursuit"),
        key("--strategies", "foveated"),
    ]

    assert len(set(keys)) == len(keys)


def test_number_of_processes_and_clips_leave_the_key_of_a_clip() -> None:
    other = ("--jobs", "7", "--clips", "5")

    assert key("--strategies", "context", *other) == key("--strategies", "context")


@pytest.mark.lengthy
def test_an_interrupted_score_of_many_objects_continues(tmp_path: Path) -> None:
    pytest.importorskip("trackeval")
    report = tmp_path / "report.json"
    words = [*SHORT, "--strategies", "context", "--report", str(report), "--jobs", "1"]

    first = CliRunner().invoke(command, words)
    whole = json.loads(report.read_text())
    kept, lost = sorted((tmp_path / "report.work").glob("procedural-*.json"))
    rows = json.loads(kept.read_text())
    kept.write_text(json.dumps([row | {"boxes": 12345} for row in rows]))
    lost.write_text('[{"cut": ')
    second = CliRunner().invoke(command, words)

    assert (first.exit_code, second.exit_code) == (0, 0), first.output + second.output
    before, after = whole["rows"], json.loads(report.read_text())["rows"]
    assert [row["clip"] for row in before] == ["procedural-70000"] * 2 + ["procedural-70001"] * 2
    assert [row["boxes"] for row in after[:2]] == [12345] * 2, "the finished clip is read"
    assert after[2:] == before[2:], "the damaged one is scored again"
