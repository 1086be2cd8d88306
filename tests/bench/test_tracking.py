"""The evaluation: equal budgets, states of the ball, intervals, the same windows as the loop."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.tracking.budgets import acquisition, parsed
from bench.tracking.camera import Camera
from bench.tracking.classes import planned
from bench.tracking.clip import Clip, ClipName, names, read
from bench.tracking.episode import Loop, Rules, run
from bench.tracking.evaluate import command
from bench.tracking.intervals import Block, difference, mean
from bench.tracking.replaced import Replaced
from bench.tracking.sight import watched
from bench.tracking.stages import Stages
from bench.tracking.targets import CARRIED, FREE, STILL, ball_states, starts, targets
from drivers.source import Annotations
from pipeline.boxes import centres, iou
from pipeline.errors import DriverError, RunError, SettingsError
from pipeline.messages import Frame, Tracks
from pipeline.run.inline import InlineRunner
from tests.drivers.sequences import write_sequence

ROOT = Path(__file__).resolve().parents[2]
GRAPH = ROOT / "graphs" / "learned.yaml"
HD = (1920, 1080)
STRATEGIES = ("spatial", "temporal", "exposure", "foveated", "centred", "round_robin", "oracle")


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("budget", ["1/4", "1/8", "1/16"])
def test_every_strategy_spends_its_budget_within_one_percent(strategy: str, budget: str) -> None:
    how = acquisition(strategy, Fraction(budget), HD)

    spent = how.sampling.emitted_px() / (HD[0] * HD[1]) / how.sampling.interval

    assert spent == pytest.approx(float(Fraction(budget)), rel=0.01)


@pytest.mark.parametrize("budget", ["1/4", "1/8", "1/16", "1/32", "1/100", "1/200", "1/256"])
def test_the_context_alone_is_what_a_foveated_row_has_beside_its_roi(budget: str) -> None:
    alone, foveated = (
        acquisition(strategy, Fraction(budget), HD) for strategy in ("context", "foveated")
    )

    assert alone.sampling.context_px == foveated.sampling.context_px


@pytest.mark.parametrize("text", ["1/1000", "0", "2", "a", "1/0"])
def test_a_budget_that_cannot_be_met_is_refused(text: str) -> None:
    def spent() -> None:
        for budget in parsed(text):
            acquisition("foveated", budget, HD)

    with pytest.raises(SettingsError, match="budgets: expected"):
        spent()


def truth(ball: tuple[float, float], *people: tuple[float, float]) -> Annotations:
    boxes = [(x - 8, y - 8, x + 8, y + 8) for x, y in (ball,)]
    boxes += [(x - 20, y - 60, x + 20, y + 60) for x, y in people]
    return Annotations(
        boxes=np.array(boxes, np.float32),
        ids=np.arange(len(boxes), dtype=np.int32),
        labels=("ball", *["player"] * len(people)),
        visibility=np.ones(len(boxes), np.float32),
    )


def states(truths: list[Annotations], width_px: int = HD[0]) -> set[str]:
    boxes = np.stack([t.boxes[0] for t in truths])
    return set(ball_states(boxes, truths, width_px))


CROWD = ((100.0, 500.0), (300.0, 600.0), (500.0, 400.0), (700.0, 500.0))


def test_a_ball_is_still_free_or_carried_according_to_the_truth() -> None:
    def panned(k: int) -> tuple[tuple[float, float], ...]:
        return tuple((x + 6.0 * k, y) for x, y in CROWD)

    lying = [truth((900 + 6.0 * k, 300), *panned(k)) for k in range(12)]
    flying = [truth((900 + 12.0 * k, 300), *CROWD) for k in range(12)]
    carried = [truth((100 + 5.0 * k, 480), (100 + 5.0 * k, 500), *CROWD[1:]) for k in range(12)]

    assert (states(lying), states(flying), states(carried)) == ({STILL}, {FREE}, {CARRIED})


def test_a_ball_is_as_still_in_a_wider_picture_of_the_same_field() -> None:
    def wider(by: float, speed_px: float) -> set[str]:
        truths = [truth((900 + speed_px * k, 300), *CROWD) for k in range(12)]
        return states([replace(t, boxes=by * t.boxes) for t in truths], int(by * HD[0]))

    assert [wider(4.0, speed_px) for speed_px in (1.0, 2.0)] == [{STILL}, {FREE}]
    assert [wider(1.0, speed_px) for speed_px in (1.0, 2.0)] == [{STILL}, {FREE}]


@pytest.mark.parametrize(
    ("frames", "drift_px", "state"),
    [(5, 0.0, CARRIED), (4, 0.0, FREE), (12, 11.0, CARRIED), (12, 14.0, FREE)],
    ids=["five frames", "four frames", "moves in the hands", "passes through"],
)
def test_a_carried_ball_is_in_one_persons_box_for_five_frames_and_moves_with_it(
    frames: int, drift_px: float, state: str
) -> None:
    def at(k: int) -> Annotations:
        person = (100 + 12.0 * k, 500.0)  # 120 px tall
        swing = drift_px if k % 2 else 0.0
        held = (person[0], person[1] + 20 + swing)
        return truth(held if k < frames else (900 + 30.0 * k, 100), person, *CROWD[1:])

    truths = [at(k) for k in range(14)]
    found = ball_states(np.stack([t.boxes[0] for t in truths]), truths, HD[0])

    assert set(found[:frames]) == {state}
    assert CARRIED not in found[frames:]


def test_a_ball_handed_from_one_person_to_another_is_not_carried_by_both_together() -> None:
    near = [(100.0, 500.0), (145.0, 500.0)]
    truths = [truth(near[k // 3], *near, *CROWD[1:]) for k in range(6)]

    assert states(truths) == {STILL}


def test_a_tracker_is_started_where_the_target_is_visible() -> None:
    truths = [truth((900, 300), *CROWD) for _ in range(20)]
    truths[8] = Annotations(
        boxes=truths[8].boxes,
        ids=truths[8].ids,
        labels=truths[8].labels,
        visibility=np.full(5, 0.1, np.float32),
    )

    (ball,) = targets(truths, ["ball"], players=1, seed=0, width_px=HD[0])

    assert starts(ball, 8) == [0, 16]


def test_players_are_drawn_by_the_seed() -> None:
    truths = [truth((900, 300), *CROWD) for _ in range(4)]

    drawn = [targets(truths, ["player"], players=2, seed=s, width_px=HD[0]) for s in range(8)]

    assert all(len(found) == 2 for found in drawn)
    assert len({tuple(t.id for t in found) for found in drawn}) > 1
    again = targets(truths, ["player"], players=2, seed=3, width_px=HD[0])
    assert [t.id for t in again] == [t.id for t in drawn[3]]


def blocks(*values: float) -> dict[str, Block]:
    return {f"clip {k}": Block(total=10 * v, frames=10, starts=1) for k, v in enumerate(values)}


def test_an_interval_contains_the_mean_and_shrinks_with_more_clips() -> None:
    rng = np.random.default_rng(1)
    few, many = (mean(blocks(*rng.normal(0.5, 0.1, n))) for n in (8, 200))

    for found in (few, many):
        assert found.low < found.iou < found.high
    assert many.high - many.low < 0.5 * (few.high - few.low)
    assert (many.frames, many.starts) == (2000, 200)


def test_a_small_difference_in_every_clip_has_an_interval_without_zero() -> None:
    base = np.random.default_rng(2).uniform(0.1, 0.9, 30)
    better, worse = blocks(*base + 0.02), blocks(*base)

    middle, low, high = difference(better, worse)

    assert middle == pytest.approx(0.02)
    assert 0 < low <= high
    assert mean(better).low < mean(worse).high  # unpaired, it would be hidden


@pytest.fixture(scope="module")
def clip() -> Clip:
    return read(ClipName(seed=70_003), (1, 14))


@pytest.fixture(scope="module")
def stages() -> Iterator[Stages]:
    """Open the stages with the pursuit policy; each episode begins a new stream."""
    with Stages(GRAPH, policy="pursuit") as stages:
        yield stages


def loop(
    camera: Camera, stages: Stages, tracks: Mapping[int, Tracks] | None = None, **rules: bool
) -> Loop:
    return Loop(camera=camera, stages=stages, tracks=tracks or {}, rules=Rules(**rules))  # type: ignore[arg-type]


@pytest.mark.lengthy
@pytest.mark.parametrize(("graph", "policy"), [("learned", "pursuit"), ("tracking", "")])
def test_an_episode_has_the_windows_of_the_running_loop(
    clip: Clip, graph: str, policy: str
) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    box = [float(v) for v in ball.boxes[0]]
    aim = ("policy.target=''", f"policy.prompt_box={box}")
    sensor = ("capture.options.seed=70003", "capture.options.rate_hz=25")
    looked: list[tuple[int, ...]] = []

    def note(output: str, message: object) -> None:
        if output == "capture.roi" and isinstance(message, Frame):
            looked.append(message.window)

    path = GRAPH.with_stem(graph)
    plan = planned(path, (*aim, *sensor), policy=policy)
    with InlineRunner(plan, watch=note) as runner:
        list(runner.run(14))

    camera = Camera(clip, acquisition("foveated", Fraction(1, 8), clip.size_px))
    with Stages(path, policy=policy) as stages:
        tracks = watched(camera, stages, 14, Replaced())
        outcome = run(loop(camera, stages, tracks, aimed=False), ball, 0)

    assert outcome.windows == looked
    assert len(set(looked)) > 1
    assert outcome.read_px == pytest.approx(14 * HD[0] * HD[1] / 8, rel=0.01)


def test_a_roi_on_the_target_is_as_good_as_full_resolution(clip: Clip, stages: Stages) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    means = {}
    for strategy in ("full", "oracle", "spatial"):
        camera = Camera(clip, acquisition(strategy, Fraction(1, 16), clip.size_px))
        outcome = run(loop(camera, stages), ball, 0)
        means[strategy] = np.nanmean(outcome.iou)

    assert means["full"] == pytest.approx(means["oracle"], abs=0.1)
    assert means["spatial"] <= means["full"] + 0.05


def test_a_perfect_tracker_has_the_true_box_while_the_roi_shows_the_target(clip: Clip) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    camera = Camera(clip, acquisition("oracle", Fraction(1, 8), clip.size_px))
    known = Replaced(parts=frozenset({"tracker"}), truths=clip.truths)

    with Stages(GRAPH, policy="pursuit") as stages:
        outcome = run(replace(loop(camera, stages), replaced=known), ball, 0)

    assert np.nanmin(outcome.iou) == pytest.approx(1)


def test_a_tracker_that_sees_the_roi_alone_holds_its_box_while_the_target_is_outside(
    clip: Clip,
) -> None:
    found = targets(clip.truths, ["player"], players=99, seed=0, width_px=clip.size_px[0])
    players = [t for t in found if t.visible.min() > 0.9]
    aside = max(players, key=lambda t: abs(float(centres(t.boxes[0])[0]) - HD[0] / 2))
    camera = Camera(clip, acquisition("centred", Fraction(1, 16), clip.size_px))

    with Stages(GRAPH, policy="pursuit") as stages:
        alone, both = (
            run(loop(camera, stages, context=context), aside, 0) for context in (False, True)
        )

    held = [float(iou(aside.boxes[:1], box[None])[0, 0]) for box in aside.boxes[1:]]
    assert max(alone.shown) == 0
    assert alone.iou == pytest.approx(held)
    assert np.mean(both.iou) > np.mean(held)


def test_a_window_of_more_pixels_than_the_budget_has_is_refused(clip: Clip) -> None:
    camera = Camera(clip, acquisition("foveated", Fraction(1, 8), HD))
    quarter = acquisition("foveated", Fraction(1, 4), HD).sampling.roi_px
    assert quarter is not None

    with pytest.raises(RunError, match=r"expected a window of \(480, 270\)"):
        camera.roi(3, (0, 0, *quarter))


@pytest.mark.parametrize("strategy", ["full", *STRATEGIES])
def test_the_pixels_that_the_sensor_reads_in_an_episode_are_counted(
    clip: Clip, stages: Stages, strategy: str
) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    how = acquisition(strategy, Fraction(1, 8), clip.size_px)
    camera = Camera(clip, how)

    tracks = watched(camera, stages, 14, Replaced())
    both, alone = (
        run(loop(camera, stages, tracks, context=context), ball, 2) for context in (True, False)
    )

    assert both.read_px / both.full_px == pytest.approx(float(how.budget), rel=0.01)
    assert (alone.read_px, alone.full_px) == (both.read_px, both.full_px)


def test_an_episode_that_reads_more_than_its_budget_is_refused(clip: Clip, stages: Stages) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    quarter = acquisition("oracle", Fraction(1, 4), clip.size_px)
    camera = Camera(clip, replace(quarter, budget=Fraction(1, 8)))

    with pytest.raises(RunError, match=r"oracle read 0\.25\d* of the pixels, expected 0\.125"):
        run(loop(camera, stages), ball, 0)


def test_an_episode_can_use_the_windows_of_an_earlier_one(clip: Clip, stages: Stages) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    camera = Camera(clip, acquisition("oracle", Fraction(1, 8), clip.size_px))
    first = run(loop(camera, stages), ball, 2)
    again = run(loop(camera, stages), ball, 2, first.windows)

    assert (again.windows, again.iou) == (first.windows, first.iou)


def test_data_of_the_wrong_shape_is_refused_in_one_sentence(tmp_path: Path) -> None:
    write_sequence(tmp_path / "clip", gameinfo="[Sequence]\nnum_tracklets=0\n")

    with pytest.raises(DriverError, match="expected a folder of SoccerNet sequences, found none"):
        names(str(tmp_path / "nothing"), 1)
    with pytest.raises(DriverError, match=r"expected seqinfo\.ini in it or in its folders"):
        names(str(tmp_path / "clip" / "img1"), 1)
    with pytest.raises(DriverError, match="expected gt"):
        names(str(tmp_path), 1)
    with pytest.raises(SettingsError, match="expected procedural:SEED"):
        names("procedural:x", 1)
    with pytest.raises(SettingsError, match=r"frames: .* has 1 to any, got 5-2"):
        read(ClipName(seed=1), (5, 2))


@pytest.mark.lengthy
def test_a_whole_evaluation_is_written_and_continues_where_it_stopped(tmp_path: Path) -> None:
    words = [
        *("--data", "procedural:70003", "--clips", "1", "--frames", "1-20", "--jobs", "1"),
        *("--strategies", "centred,temporal,foveated", "--budgets", "1/4,1/8", "--targets", "ball"),
        *("--tracker", "correlation", "--policy", "pursuit", "--report", str(tmp_path / "r.json")),
        *("--cue", "none"),
        *(
            "--sees",
            "each",
            "--plot",
            str(tmp_path / "plot.png"),
            "--markdown",
            str(tmp_path / "table.md"),
        ),
    ]
    first = CliRunner().invoke(command, words, catch_exceptions=False)
    report = json.loads((tmp_path / "r.json").read_text())
    units = sorted((tmp_path / "r.work").glob("*.json"))
    written = [unit.stat().st_mtime_ns for unit in units]
    units[0].unlink()

    again = CliRunner().invoke(command, words, catch_exceptions=False)

    assert (first.exit_code, again.exit_code) == (0, 0)
    assert json.loads((tmp_path / "r.json").read_text())["rows"] == report["rows"]
    after = sorted((tmp_path / "r.work").glob("*.json"))
    assert [unit.stat().st_mtime_ns for unit in after[1:]] == written[1:]
    wanted = {"clip", "target", "strategy", "budget", "iou", "ci95", "frames", "starts", "pixels"}
    assert all(wanted <= set(row) for row in report["rows"])
    assert {(row["strategy"], row["against"]) for row in report["paired"]} == {
        *(("foveated, no cue", f"{against}, no cue") for against in ("centred", "temporal")),
        *(
            ("foveated, ROI alone, no cue", against)
            for against in ("centred, ROI alone, no cue", "temporal, no cue")
        ),
    }
    assert "| ball | 1/8 | foveated, no cue |" in (tmp_path / "table.md").read_text()
    assert "|" not in first.stdout
    assert "ball at 1/8 of the pixels: foveated" in first.stdout
    assert first.stdout.splitlines()[-1].startswith("No interval is given: frames of one clip")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
