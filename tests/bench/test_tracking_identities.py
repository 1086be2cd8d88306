"""Many objects under one ROI: what a strategy shows of the same tracks, and who they are then."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner

from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera
from bench.tracking.clip import ClipName, read
from bench.tracking.evaluate import command
from bench.tracking.identities import ROI_STAGES, Knowing, Planned, Played, identified
from bench.tracking.many import identity_of
from bench.tracking.many_tables import means_of_many, paired_of_many
from bench.tracking.options import GRAPH
from bench.tracking.replaced import Replaced
from bench.tracking.sight import PERCEPTION, watched
from bench.tracking.stages import Stages
from operators.identity import IdentitySettings
from pipeline.boxes import covered

FRAMES = 14


@pytest.fixture(scope="module")
def played() -> Iterator[Played]:
    clip = read(ClipName(seed=60_001), (1, FRAMES))
    camera = Camera(clip, acquisition("foveated", Fraction(1, 8), clip.size_px))
    with (
        Stages(GRAPH, needed=PERCEPTION) as sight,
        Stages(GRAPH, policy="greedy", needed=ROI_STAGES) as stages,
    ):
        yield Played(
            camera=camera,
            stages=stages,
            tracks=watched(camera, sight, FRAMES, Replaced()),
            truths=clip.truths,
            identity=IdentitySettings(),
        )


@pytest.mark.lengthy
def test_every_strategy_names_the_same_tracks_of_every_frame(played: Played) -> None:
    for strategy in ("greedy", "centred", "oracle", "everybody", "recognised", "truth"):
        found = identified(played, strategy)

        assert list(found.tracks) == list(range(FRAMES))
        for frame, tracks in found.tracks.items():
            own = played.tracks[frame].boxes[:, -1]
            assert set(map(tuple, tracks.boxes[:, -1])) <= set(map(tuple, own))
            assert len(set(tracks.ids.tolist())) == len(tracks.ids)


@pytest.mark.lengthy
def test_everybody_is_shown_in_every_frame_and_a_window_shows_fewer(played: Played) -> None:
    tracks = sum(len(each.ids) for each in played.tracks.values())

    every, greedy = identified(played, "everybody").looks, identified(played, "greedy").looks

    assert every == tracks
    assert 0 < greedy < every


@pytest.mark.lengthy
def test_the_truth_names_every_track_of_a_person_by_its_id(played: Played) -> None:
    found = identified(played, "truth").tracks[FRAMES - 1]

    people = set(played.truths[FRAMES - 1].ids.tolist())
    assert people & set(found.ids.tolist())
    assert all(i in people or i > 1000 for i in found.ids.tolist())


@pytest.mark.lengthy
def test_a_late_plan_is_that_of_an_earlier_frame(played: Played) -> None:
    windows = {}
    for delay in (0, 3):
        path = Planned(replace(played, delay=delay))
        windows[delay] = []
        for frame in range(FRAMES):
            windows[delay].append(path.window(frame))
            path.after_tracks(frame)

    first = next(k for k in range(FRAMES) if len(played.tracks[k].ids))
    assert windows[0][first + 1] != windows[3][first + 1]
    assert len(set(windows[3][: first + 4])) == 1  # the middle
    assert len(set(windows[3][first + 4 :])) > 1


@pytest.mark.lengthy
def test_the_oracle_looks_at_people_where_they_are(played: Played) -> None:
    path = Knowing(played)

    for frame in range(FRAMES):
        window = np.array(path.window(frame), np.float32)
        assert (covered(played.truths[frame].boxes, window) >= 0.8).any()


@pytest.mark.lengthy
def test_a_graph_without_identity_has_its_defaults(played: Played) -> None:
    assert identity_of(played.stages) == IdentitySettings()


def row(strategy: str, clip: str, hota: float, *, boxes: int = 9) -> dict[str, object]:
    figures = {"HOTA": hota, "DetA": 0.5, "AssA": hota, "IDF1": hota, "boxes": boxes}
    told = {"target": "people", "budget": "1/8", "strategy": strategy, "clip": clip}
    return {**told, **figures}


def test_means_have_intervals_from_six_clips_on() -> None:
    rows = [row("greedy", str(k), 0.5 + 0.01 * k) for k in range(6)]

    (few,), (enough,) = means_of_many(rows[:5]), means_of_many(rows)

    assert "HOTA_ci95" not in few
    assert enough["HOTA_ci95"][0] < enough["HOTA"] == 0.525 < enough["HOTA_ci95"][1]
    assert enough["clips"] == 6


def test_a_clip_that_never_shows_the_target_is_in_no_mean() -> None:
    rows = [row(name, str(k), 0.6) for name in ("context", "greedy") for k in range(6)]
    rows += [row(name, "without", 0.0, boxes=0) for name in ("context", "greedy")]

    means = means_of_many(rows)

    assert [(each["HOTA"], each["clips"]) for each in means] == [(0.6, 6), (0.6, 6)]
    assert paired_of_many(rows)[0]["HOTA"] == [0, 0, 0]
    assert means_of_many(rows[-2:]) == []


def test_strategies_are_compared_clip_by_clip() -> None:
    rows = [row("context", str(k), 0.1 * k) for k in range(6)]
    rows += [row("greedy", str(k), 0.1 * k + 0.02) for k in range(6)]

    (beside_context, beside_greedy) = paired_of_many(rows)[::-1]

    assert (beside_context["strategy"], beside_context["beside"]) == ("greedy", "context")
    assert beside_context["HOTA"] == pytest.approx([0.02, 0.02, 0.02])
    assert (beside_greedy["strategy"], beside_greedy["beside"]) == ("context", "greedy")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--missed", "1"], "missed: expected 0 to below 1, got 1.0"),
        (["--strategies", "temporal"], "strategies: with --many expected full, spatial, context"),
        (["--strategies", "greedy", "--delay", "16"], "delay: plans reach 16 frames"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_measured(words: list[str], said: str) -> None:
    pytest.importorskip("trackeval")
    result = CliRunner().invoke(command, ["--data", "procedural", "--many", *words])

    assert result.exit_code == 2
    assert result.output.startswith(f"fovea eval tracking: {said}")
