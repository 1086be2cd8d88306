"""Counting identities, and the rows of their evaluation."""

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("rapidocr")

from bench.shirts import evaluate
from bench.shirts.tally import Counts, IdentityTally, on_people
from bench.shirts.trial import STRATEGIES, Job, Outcome, plan_of, rate_of
from drivers.source import Annotations
from operators.transcribed import ILLEGIBLE
from pipeline.errors import GraphError, SettingsError
from pipeline.messages import Percept
from pipeline.testing import header

A, B = (100.0, 100.0, 140.0, 200.0), (400.0, 100.0, 440.0, 200.0)
Box = tuple[float, float, float, float]


def truth(labels: dict[int, tuple[Box, str]], seen: float = 1.0) -> Annotations:
    return Annotations(
        boxes=np.array([box for box, _ in labels.values()], np.float32).reshape(-1, 4),
        ids=np.array([*labels], np.int32),
        labels=tuple(label for _, label in labels.values()),
        visibility=np.full(len(labels), seen, np.float32),
    )


def percept(seq: int, *named: tuple[Box, str]) -> Percept:
    return Percept(
        header=header(seq),
        boxes=np.array([box for box, _ in named], np.float32).reshape(-1, 4),
        ids=np.arange(len(named), dtype=np.int32),
        scores=np.ones(len(named), np.float32),
        texts=tuple(text for _, text in named),
    )


PEOPLE = truth({1: (A, "player"), 2: (B, "player")})
BACKS = truth({1: (A, "23"), 2: (B, ILLEGIBLE)})


def counted(*frames: tuple[tuple[Box, str], ...]) -> Counts:
    tally = IdentityTally(numbers={1: "23", 2: "9"})
    for seq, named in enumerate(frames):
        tally.add(seq, percept(seq, *named), PEOPLE, BACKS)
    return tally.counts()


def test_a_name_that_stays_is_kept_and_one_that_goes_is_not() -> None:
    found = counted((), ((A, "23"),), ((A, "23"),), (), ((A, "28"),))

    assert (found.legible, found.read, found.waits) == (1, 1, (1,))
    assert (found.after, found.kept, found.wrong) == (3, 1, 1)
    assert (found.named, found.named_rightly) == (3, 2)


def test_a_name_on_another_player_is_not_right() -> None:
    found = counted(((B, "23"),), ((B, "23 WEISS"),))

    assert (found.read, found.after, found.named_rightly) == (0, 0, 0)
    assert found.named == 2


@pytest.mark.parametrize(
    ("second", "rightly", "wrong"), [("23 WEISS", 4, 0), ("28", 2, 1)], ids=["agree", "disagree"]
)
def test_two_tracks_on_one_player_have_a_name_each(second: str, rightly: int, wrong: int) -> None:
    both = ((A, "23"), (A, second))

    found = counted(both, both)

    assert (found.named, found.named_rightly) == (4, rightly)
    assert (found.after, found.kept, found.wrong) == (1, 1, wrong)


def test_a_player_who_is_never_legible_counts_as_kept_but_in_no_share_of_the_legible() -> None:
    found = counted(((B, "9"),), ((B, "9"),))

    assert (found.legible, found.read) == (1, 0)
    assert (found.after, found.kept) == (1, 1)


def test_a_hidden_player_does_not_count() -> None:
    tally = IdentityTally(numbers={1: "23"})
    tally.add(0, percept(0, (A, "23")), PEOPLE, BACKS)
    tally.add(1, percept(1), truth({1: (A, "player")}, seen=0.2), BACKS)

    assert tally.counts().after == 0


def test_readings_stand_for_the_people_on_whom_they_are() -> None:
    on_back, nowhere = (110.0, 130.0, 130.0, 145.0), (200.0, 130.0, 220.0, 145.0)

    found = on_people(percept(0, (on_back, "23"), (nowhere, "9")), PEOPLE)

    assert found.texts == ("23",)
    assert found.boxes.tolist() == [list(A)]


def job(strategy: str, **given: Any) -> Job:
    budget = Fraction(1) if strategy == "full" else Fraction(1, 8)
    known = {"graph": str(evaluate.GRAPH), "changes": (), "frames": 4, "seed": 70_000}
    return Job(**{**known, "strategy": strategy, "budget": budget, **given})


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_row_has_the_nodes_that_it_needs(strategy: str) -> None:
    plan = plan_of(job(strategy))

    nodes = {node.name for node in plan.nodes}
    aimed = strategy not in ("full", "context", "spatial", "centred", "round_robin")
    assert {"capture", "saliency", "association", "reader", "names"} <= nodes
    assert ({"policy", "dispatch"} <= nodes) == aimed
    assert "visualise" not in nodes
    seen = plan.inputs("names")["roi"].output
    assert seen == ("context" if strategy in ("full", "context", "spatial") else "roi")


def test_other_strategies_and_graphs_are_refused() -> None:
    with pytest.raises(SettingsError, match="strategies: expected foveated"):
        plan_of(job("best"))
    with pytest.raises(GraphError, match="shirts are read with a node names, got none"):
        plan_of(job("foveated", graph=str(evaluate.GRAPH.with_name("text.yaml"))))


def test_waits_are_of_the_graphs_own_rate() -> None:
    assert rate_of(plan_of(job("foveated"))) == 30.0
    assert rate_of(plan_of(job("foveated", changes=("capture.rate_hz=60",)))) == 60.0
    assert evaluate.summed(("full", Fraction(1)), [outcome(4, 20)], 60.0)["wait_s"] == 0.5


def outcome(read: int, kept: int) -> Outcome:
    counts = Counts(
        legible=4, read=read, kept=kept, wrong=1, after=20, named=30, named_rightly=25, waits=(30,)
    )
    return Outcome(counts=counts, alone=counts, pixels=0.125)


def test_clips_are_summed_and_finished_ones_are_not_played_again(tmp_path: Path) -> None:
    words = ["--strategies", "foveated,context", "--clips", "2", "--frames", "4"]
    words += ["--report", str(tmp_path / "r.json"), "--work", str(tmp_path / "work")]
    (tmp_path / "work").mkdir()
    for strategy in ("foveated", "context"):
        for clip, (read, kept) in enumerate(((4, 20), (2, 10))):
            path = tmp_path / "work" / f"{evaluate.key(job(strategy, seed=70_000 + clip))}.json"
            path.write_text(json.dumps(asdict(outcome(read, kept))))
    result = CliRunner().invoke(evaluate.command, words)

    assert result.exit_code == 0, result.output
    first = json.loads((tmp_path / "r.json").read_text())["rows"][0]
    assert (first["strategy"], first["legible"]) == ("foveated", 8)
    assert (first["named"], first["kept"], first["wrong"]) == (0.75, 0.75, 0.05)
    assert first["alone"]["read"] == 0.75
    assert first["wait_s"] == 1.0
    assert "foveated | 1/8 | 0.750 |  | 0.750 | 8 | 1.0" in result.output


@pytest.mark.parametrize("text", ["", "{", "[]", '{"pixels": 0.125}', "\x80"])
def test_a_damaged_clip_is_played_again(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate, "trial", lambda _: outcome(4, 20))
    monkeypatch.setattr(evaluate, "pool_of", ThreadPoolExecutor)
    path = tmp_path / f"{evaluate.key(job('context'))}.json"
    path.write_bytes(text.encode("latin-1"))

    found = evaluate.measured([job("context")], tmp_path, 1)

    assert found == {job("context"): outcome(4, 20)}
    assert evaluate.read(path) == outcome(4, 20)


@pytest.mark.parametrize("words", [["--clips", "0"], ["--seed", "-1"], ["--strategies", "best"]])
def test_what_cannot_be_measured_is_refused(words: list[str], tmp_path: Path) -> None:
    result = CliRunner().invoke(evaluate.command, [*words, "--work", str(tmp_path / "work")])

    assert result.exit_code == 1
    assert "expected" in result.output


def test_a_clip_is_written_once_it_is_over_whatever_came_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, quick = job("foveated"), job("full")
    written = threading.Event()

    def played(asked: Job) -> Outcome:
        if asked == slow:
            assert written.wait(20), "the quick clip was not written while the slow one was played"
        return outcome(4, 20)

    def write(path: Path, text: str) -> None:
        path.write_text(text)
        written.set()

    monkeypatch.setattr(evaluate, "trial", played)
    monkeypatch.setattr(evaluate, "pool_of", ThreadPoolExecutor)
    monkeypatch.setattr(evaluate, "write_whole", write)

    assert len(evaluate.measured([slow, quick], tmp_path, 2)) == 2
