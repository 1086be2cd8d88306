"""The first lines of a report judge the run by the figures of the report."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pipeline.bus.ledger import Ledger, private_ledger
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan, sources
from pipeline.graph.shipped import graph_path
from pipeline.run.report import Report, compose, print_report
from pipeline.run.verdict import MOST_HEADLINES, Finding, rate_of, verdict

PLAN = load(graph_path("tracking"))
TOLD = {"rate": {"asked_hz": 30, "achieved_hz": 30}}


def ran(frames: int = 300, plan: Plan = PLAN, loop_ms: float = 0) -> Ledger:
    """Return the ledger of a run in which every message arrived."""
    ledger = private_ledger(len(plan.edges), len(plan.nodes))
    for account in ledger.edges:
        account.sent = account.delivered = frames
    (source,) = sources(plan)
    histograms = ledger.nodes[source.index].histograms
    for _ in range(frames):
        histograms["handler"].add(1_000_000)
        if loop_ms:
            histograms["loop"].add(round(loop_ms * 1e6))
    return ledger


def composed(
    ledger: Ledger | None = None, plan: Plan = PLAN, duration_s: float = 10.0, **told: Any
) -> Report:
    summaries = {"capture": TOLD, **told}
    return compose(plan, ledger or ran(plan=plan), summaries, {}, duration_s=duration_s)


def found(report: Report, about: str) -> Finding:
    (finding,) = (each for each in verdict(report) if each.about == about)
    return finding


def printed(report: Report, *, width: int = 80, terminal: bool = False, **how: Any) -> str:
    console = Console(width=width, force_terminal=terminal, legacy_windows=False, **how)
    with console.capture() as caught:
        print_report(console, report)
    return caught.get()


@pytest.mark.parametrize(
    ("achieved_hz", "held", "said"),
    [
        (30, True, "held: 30.0 of 30.0 frames/s over 300 frames"),
        (29.8, True, "held: 29.8 of 30.0 frames/s over 300 frames"),
        (27, False, "fell short by 10%: 27.0 of 30.0 frames/s over 300 frames"),
        (0, False, "fell short by 100%: 0.00 of 30.0 frames/s over 300 frames"),
    ],
)
def test_a_source_is_judged_by_the_rate_that_it_reports(
    achieved_hz: float, held: bool, said: str
) -> None:
    told = {"rate": {"asked_hz": 30, "achieved_hz": achieved_hz}}

    finding = found(composed(capture=told), "rate")

    assert (finding.held, finding.sentence) == (held, said)


def test_a_source_that_names_no_rate_is_counted_and_not_judged() -> None:
    report = composed(capture={})

    rate, loop = found(report, "rate"), found(composed(ran(loop_ms=20), capture={}), "loop")

    assert (rate.held, loop.held) == (None, None)
    assert rate.sentence == "30.0 frames/s over 300 frames; its source names no rate to hold"
    assert loop.sentence.endswith("no budget, for its source names no rate")


def test_a_run_without_a_frame_did_not_hold_its_rate() -> None:
    assert found(composed(ran(frames=0)), "rate") == Finding(
        about="rate", held=False, sentence="no frame was made"
    )


@pytest.mark.parametrize(
    ("loop_ms", "held", "begins"),
    [(12, True, "held: "), (40, False, "over its budget, p50 by "), (0, False, "no command")],
)
def test_the_budget_of_the_loop_is_one_and_two_frames_of_its_source(
    loop_ms: float, held: bool, begins: str
) -> None:
    finding = found(composed(ran(loop_ms=loop_ms)), "loop")

    assert finding.held is held
    assert finding.sentence.startswith(begins)
    assert not loop_ms or "budget 33.3/66.7 ms" in finding.sentence


def test_only_the_percentile_that_is_over_the_budget_is_named() -> None:
    ledger = ran(frames=100, loop_ms=12)
    for _ in range(3):
        ledger.nodes[PLAN.node("capture").index].histograms["loop"].add(200_000_000)

    sentence = found(composed(ledger), "loop").sentence

    assert sentence.startswith("over its budget, p99 by 1")
    assert "p50 by" not in sentence


def test_lockstep_has_neither_a_rate_to_hold_nor_a_latency() -> None:
    plan = load(graph_path("tracking"), Overlay(clock="lockstep"))
    report = composed(plan=plan)

    text = printed(report)

    assert found(report, "rate").held is found(report, "loop").held is None
    assert "30.0 frames/s over 300 frames, in lockstep: there is no rate to hold" in text
    assert "loop: no latency: in lockstep" in text
    assert "0.00" not in text


def test_a_graph_without_commands_has_no_loop() -> None:
    plan = load(graph_path("examples/meter"))

    finding = found(composed(plan=plan), "loop")

    assert finding.held is None
    assert finding.sentence == "none: no command goes back to a source"


def test_losses_are_counted_with_the_edge_that_has_most_and_why() -> None:
    ledger = ran()
    one, other = (e for e in PLAN.edges if e.keep == "latest" and e.target == "roi_features")
    ledger.edges[one.index].superseded, ledger.edges[other.index].superseded = 2, 7

    finding = found(composed(ledger), "losses")

    assert finding.held is True  # these edges keep only the newest message
    assert finding.sentence == (
        f"9 of {300 * len(PLAN.edges)} messages on 2 edges, most on {other.origin} -> {other.end} "
        "(7, superseded); all on edges that keep only the newest"
    )


def test_a_message_that_was_promised_and_lost_is_a_failure() -> None:
    ledger = ran()
    kept = next(e for e in PLAN.edges if e.keep == "every")
    ledger.edges[kept.index].lost_in_crash = 3

    finding = found(compose(PLAN, ledger, {}, {}, duration_s=1, restarts={"policy": 2}), "losses")

    assert finding.held is False
    assert "3 of them on edges that keep every message" in finding.sentence
    assert "(with a process)" in finding.sentence
    assert finding.sentence.endswith("; restarted: policy 2 times")


@pytest.mark.parametrize(("skipped", "held"), [(24, True), (20, False)])
def test_a_picture_whose_frame_the_detector_skipped_is_no_broken_promise(
    skipped: int, held: bool
) -> None:
    ledger = ran()
    picture, detections = (
        next(e for e in PLAN.edges if e.end == f"kits.{name}") for name in ("frame", "detections")
    )
    ledger.edges[picture.index].unmatched = 24
    ledger.edges[picture.index].delivered -= 24
    ledger.edges[detections.index].sent -= skipped
    ledger.edges[detections.index].delivered -= skipped

    finding = found(composed(ledger), "losses")

    assert picture.keep == "every"
    assert finding.held is held
    assert finding.sentence.endswith(
        "24 of them of frames that their node's other inputs had missed before"
        if held
        else "4 of them on edges that keep every message"
    )


def test_a_run_without_losses_is_reported_too() -> None:
    assert found(composed(), "losses").sentence == f"none of {300 * len(PLAN.edges)} messages"


def test_the_headline_of_an_operator_is_shown_below_under_its_name() -> None:
    report = composed(score={"headline": "IoU 0.6", "iou": {"mean": 0.6}})

    assert [f.about for f in verdict(report)] == ["rate", "loop", "losses", "score"]
    assert found(report, "score").sentence == "IoU 0.6"
    assert report["headlines"] == {"score": "IoU 0.6"}
    assert "headline" not in report
    assert report["iou"] == {"mean": 0.6}


def test_the_report_holds_its_verdict_as_data() -> None:
    report = composed()

    assert report["verdict"][0] == {
        "about": "rate", "held": True, "sentence": "held: 30.0 of 30.0 frames/s over 300 frames",
    }  # fmt: skip
    assert [each["about"] for each in report["verdict"]] == ["rate", "loop", "losses"]


def test_many_headlines_are_cut_off_and_counted() -> None:
    report = composed()
    report["headlines"] = {f"node{k}": "fine" for k in range(MOST_HEADLINES + 5)}

    lines = printed(report).splitlines()

    assert len(lines) == 3 + MOST_HEADLINES + 1
    assert lines[-1] == "others: 5 nodes more have a headline"


def test_in_a_pipe_every_finding_is_one_whole_line_without_colours() -> None:
    report = composed(ran(loop_ms=400), score={"headline": "word " * 30})

    lines = printed(report, width=50).splitlines()

    assert [line.partition(":")[0] for line in lines] == ["rate", "loop", "losses", "score"]
    assert "\x1b" not in "".join(lines)


@pytest.mark.parametrize("width", [20, 50, 80, 200])
def test_a_terminal_of_any_width_shows_every_word_beside_the_names(width: int) -> None:
    report = composed(ran(loop_ms=400), score={"headline": "IoU 0.612 with the truth"})

    text = printed(report, width=width, terminal=True, no_color=True, color_system=None)

    assert max(map(len, text.splitlines())) <= width
    beside = [line.rstrip()[8:] for line in text.splitlines()]  # two columns
    assert all(not line[:6].strip() or line[6:8] == "  " for line in text.splitlines())
    told = "".join("".join(beside).split())
    for finding in verdict(report):
        assert "".join(finding.sentence.split()) in told


def test_colours_follow_the_verdict_and_go_with_no_color() -> None:
    report = composed(ran(loop_ms=400))

    plain = printed(report, terminal=True, no_color=True)
    coloured = printed(report, terminal=True, no_color=False, color_system="standard")

    assert "\x1b[32mrate" in coloured
    assert "\x1b[31mloop" in coloured
    assert "\x1b[3" not in plain


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@given(told=values, headline=values, asked=values, achieved=values)
def test_any_summary_gives_a_verdict(told: Any, headline: Any, asked: Any, achieved: Any) -> None:
    for rate in (told, {"asked_hz": asked, "achieved_hz": achieved}):
        report = composed(capture={"rate": rate, "loop": told}, score={"headline": headline})

        lines = printed(report).splitlines()

        assert [line.partition(":")[0] for line in lines[:3]] == ["rate", "loop", "losses"]
        assert len(lines) <= 4


def test_an_invalid_rate_is_replaced_by_frames_over_duration() -> None:
    for wrong in (None, 3, {}, {"asked_hz": -1, "achieved_hz": 1}, {"asked_hz": 30}):
        assert rate_of(20, 4.0, wrong) == {"frames": 20, "asked_hz": None, "achieved_hz": 5.0}
