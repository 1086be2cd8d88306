"""Policies that read, compared on recorded clips without pictures."""

import json
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

import bench.text_policies as bench
from operators.policy import GreedyReadingPolicy, GreedyReadingPolicySettings
from tests.operators.policy.recorded_texts import CONTEXT, ROI, street

TIMING = bench.Timing(delay=0, replan=1)


def greedy(*_: object, delay: int = 0) -> GreedyReadingPolicy:
    return GreedyReadingPolicy(GreedyReadingPolicySettings(delay=delay))


def test_the_oracle_reads_everything_and_no_rule_is_sooner(tmp_path: Path) -> None:
    clip = street(tmp_path)

    oracle, rule = (bench.watched(clip, make, TIMING, seed=3) for make in (bench.Oracle, greedy))

    assert oracle.read[clip.counts].all()
    assert oracle.read_at.sum() <= rule.read_at[rule.read].sum() + 24 * (~rule.read).sum()


def test_a_policy_that_knows_its_delay_shows_everything_so_much_later(tmp_path: Path) -> None:
    clip = street(tmp_path)

    soon, late = (
        bench.watched(
            clip, partial(greedy, delay=delay), bench.Timing(delay=delay, replan=1), seed=3
        )
        for delay in (0, 6)
    )

    assert (late.shown_at == soon.shown_at + 6)[clip.counts].all()


def test_rows_have_every_policy_and_differences_to_the_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch", reason="needs the train extra")
    pytest.importorskip("onnx", reason="needs the train extra")
    from operators.policy.reading.model import ReadingNet, export

    export(ReadingNet(roi_channels=ROI, context_channels=CONTEXT), tmp_path / "reading.onnx")
    for seed in (1, 2):
        street(tmp_path, seed=seed)
    monkeypatch.setattr(
        bench, "record", lambda seeds, *_, **__: [tmp_path / f"{s}.npz" for s in seeds]
    )

    result = CliRunner().invoke(bench.main, [
        "--data", str(tmp_path), "--policy", str(tmp_path / "reading.onnx"), "--first-seed", "1",
        "--clips", "2", "--json", str(tmp_path / "rows.json"),
    ])  # fmt: skip

    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    named = {row["policy"]: row for row in rows}
    assert list(named) == ["learned", "greedy", "round robin", "centred", "oracle"]
    assert {row["texts"] for row in rows} == {6}
    assert named["centred"]["shown"] == "0.000"
    assert named["greedy"]["read, above greedy"].startswith("+0.000")
