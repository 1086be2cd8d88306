"""Roll-outs: the closed loop without pictures, on clips of all that the ROI does not change."""

from pathlib import Path

import numpy as np
import pytest

from operators.policy.data import Recording, arrays
from operators.policy.decision import Rules
from operators.policy.rollout import Episode, Late, Task, roll, tasks, teacher, within
from operators.policy.utility import gains
from pipeline import Geometry, RoiFeatures, Tracks, Truth
from pipeline.boxes import centres, roi_window
from pipeline.errors import RunError
from pipeline.messages import altered
from pipeline.testing import header
from tests.operators.policy.made_up import tracks

FIELD = Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270)
NAMES = ("ball", "player", "referee")
ROI = 6


def world(seq: int) -> Tracks:
    """Return a ball that moves to the right, and three people who stand."""
    people = [(k, 1, 400.0 * k, 700.0, 0.0) for k in (2, 3, 4)]
    made = tracks(seq, (1, 0, 200 + 20.0 * seq, 500, 20), *people, channels=64)
    return altered(made, header=altered(made.header, geometry=FIELD), names=NAMES)


def recording(folder: Path, frames: int = 40) -> Recording:
    heard = []
    for seq in range(frames):
        seen = world(seq)
        truth = Truth(
            header=seen.header,
            boxes=seen.boxes[:, -1],
            ids=seen.ids + 100,
            labels=("ball", "player", "player", "main referee"),
            visibility=np.ones(4, np.float32),
        )
        looks = RoiFeatures(
            header=seen.header,
            ids=seen.ids,
            features=np.tile(seen.ids[:, None], (1, ROI)).astype(np.float32),
            genuine=np.full(4, 0.75, np.float32),
        )
        heard.append({"association.out": seen, "capture.truth": truth, "roi_features.out": looks})
    np.savez(folder / "5.npz", allow_pickle=False, **arrays(heard))
    return Recording(folder / "5.npz")


def test_a_recording_returns_the_messages_it_was_made_of(tmp_path: Path) -> None:
    clip = recording(tmp_path)
    moment, wanted = clip.moment(7), world(7)

    assert len(clip) == 40
    assert clip.geometry == FIELD
    assert moment.tracks.header.seq == 7
    assert np.array_equal(moment.tracks.boxes, wanted.boxes)
    assert np.array_equal(moment.tracks.features, wanted.features)
    assert moment.seen.features[:, 0].tolist() == [1, 2, 3, 4]
    assert moment.truth.labels == ("ball", "player", "player", "main referee")
    boxes, visible = clip.path_of(101)
    assert np.array_equal(boxes[7], wanted.boxes[0, -1])
    assert visible.all()


def test_only_objects_inside_the_roi_have_features(tmp_path: Path) -> None:
    moment = recording(tmp_path).moment(0)
    window = roi_window(centres(moment.tracks.boxes[2, -1]), FIELD)

    assert within(moment.seen, moment.tracks, window).ids.tolist() == [3]


def test_a_teacher_that_knows_the_truth_keeps_the_ball_in_view(tmp_path: Path) -> None:
    clip = recording(tmp_path)
    episode = Episode(clip, Task(clip=0, start=2, target=101), Rules(roi_channels=ROI))
    rng = np.random.default_rng(0)

    samples = roll([episode], teacher([episode], 0.0, rng), frames=30, how="argmax", rng=rng)

    assert np.mean(episode.shown) == 1
    assert len(samples) == 30
    assert samples[0].worth.shape == (4, 16)
    assert not samples[0].candidates.roi.any()  # planned before the first look was encoded
    assert samples[5].candidates.roi[0, :, 0].tolist() == [1, 1, 1, 0]


def test_late_and_rare_plans_lose_a_fast_object(tmp_path: Path) -> None:
    clip = recording(tmp_path)
    rng = np.random.default_rng(0)

    def shown(**how: int) -> float:
        episode = Episode(clip, Task(clip=0, start=2, target=101, **how), Rules(roi_channels=ROI))
        roll([episode], teacher([episode], 0.0, rng), frames=30, how="argmax", rng=rng)
        return float(np.mean(episode.shown))

    assert shown(delay=2) == 1  # predicted well enough
    assert shown(delay=14, replan=16) < 1


def test_the_worth_is_that_of_the_windows_ahead(tmp_path: Path) -> None:
    clip = recording(tmp_path)
    episode = Episode(clip, Task(clip=0, start=2, target=101), Rules(roi_channels=ROI))
    candidates, _ = episode.look()

    ahead, _ = clip.path_of(101)
    assert np.array_equal(episode.worth(), gains(candidates.path, ahead[3:19], FIELD))
    assert episode.worth()[0].min() == 1


@pytest.mark.parametrize("seed", [1, 2])
def test_tasks_follow_visible_objects_and_are_the_same_for_the_same_seed(
    tmp_path: Path, seed: int
) -> None:
    clips = [recording(tmp_path)]

    found = tasks(clips, 200, frames=20, seed=seed, late=Late())

    assert found == tasks(clips, 200, frames=20, seed=seed, late=Late())
    assert found != tasks(clips, 200, frames=20, seed=seed + 1, late=Late())
    share = np.mean([task.target == 101 for task in found])
    assert 0.4 < share < 0.6
    assert {task.prompt for task in found if task.target == 102} == {"box"}
    assert {task.prompt for task in found if task.target == 101} == {"box", "class"}
    plain = tasks(clips, 50, frames=20, seed=seed, late=None)
    assert {(t.prompt, t.replan, t.delay) for t in plain} == {("box", 1, 0)}


def test_headers_have_the_number_of_the_frame(tmp_path: Path) -> None:
    assert recording(tmp_path).header(3).seq == header(3).seq


def test_clips_without_anything_to_follow_are_refused_and_not_searched_for_ever(
    tmp_path: Path,
) -> None:
    clip = recording(tmp_path, frames=4)
    clip.people_and_ball = dict.fromkeys(clip.people_and_ball, "car")

    with pytest.raises(RunError, match=r"expected clips in whose first part a ball, .* got car; "):
        tasks([clip], 2, frames=4, seed=1, late=None)
