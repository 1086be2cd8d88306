"""The comparison of trackers: what is scored, and against what."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.trackers import Followed, figures, followed, main, targets
from drivers.scenes.panorama import PanoramaScene
from operators.tracker.look import Streams

LENGTH = 4
Box = np.ndarray


class Still:
    """Stays where it started; the truth moves on."""

    patience_score = 0.5

    def __init__(self, score: float) -> None:
        self.score = score

    def start(self, streams: Streams, box: Box) -> None:
        pass

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        return box + 1000, self.score


def world() -> PanoramaScene:
    return PanoramaScene(
        size_px=(640, 360), seed=3, length=LENGTH, objects=3, person_share=0.1, ball_share=0.05
    )


def test_the_frame_of_the_start_is_not_scored_and_all_others_are():
    paths = followed(world(), "clip", LENGTH, {"still": lambda: Still(1.0)})["still"]

    assert {p.kind for p in paths} == {"ball", "player", "referee"}
    assert all(len(p.overlaps) <= LENGTH - 1 and len(p.cpu_ms) == LENGTH - 1 for p in paths)


def test_a_box_that_its_tracker_does_not_believe_in_is_not_taken():
    sure, unsure = (
        followed(world(), "clip", LENGTH, {"still": lambda s=s: Still(s)})["still"]
        for s in (1.0, 0.0)
    )

    assert min(p.apart_px.min() for p in sure) > 500
    assert max(p.apart_px.max() for p in unsure) < 100


def test_one_target_of_each_class_is_chosen_the_same_every_time():
    assert targets(world(), LENGTH) == targets(world(), LENGTH)
    assert set(targets(world(), LENGTH)) == {"ball", "player", "referee"}


def path(clip: str, overlap: float, apart_px: float) -> Followed:
    return Followed(
        clip=clip, kind="ball",
        overlaps=np.full(4, overlap, np.float32),
        apart_px=np.full(4, apart_px, np.float32),
        cpu_ms=np.ones(4, np.float32),
    )  # fmt: skip


def test_figures_are_means_over_objects_with_an_interval_over_clips():
    paths = [path(str(k), 0.62 if k % 2 else 0.0, 5 if k % 2 else 50) for k in range(8)]

    row = figures(paths, seed=1)

    assert row["success_at_half"]["mean"] == row["precision_20_px"]["mean"] == 0.5
    low, high = row["success_at_half"]["interval"]
    assert low < 0.5 < high
    assert row["success"]["mean"] == pytest.approx(0.5 * 13 / 21, abs=1e-3)


def test_few_clips_give_no_interval():
    assert figures([path("only", 0.8, 1)] * 9, seed=1)["success"]["interval"] == []


def test_a_sequence_that_is_not_there_is_one_sentence(tmp_path: Path):
    answer = CliRunner().invoke(main, ["--footage", str(tmp_path / "no")])

    assert answer.exit_code == 1
    assert "footage: expected a SoccerNet sequence" in answer.output
