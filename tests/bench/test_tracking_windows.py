"""Pictures too large to be made are evaluated through windows of them."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera, Kept
from bench.tracking.clip import Clip, ClipName, names, read
from bench.tracking.cue import Cue
from bench.tracking.episode import Loop, Rules, run
from bench.tracking.options import GRAPH
from bench.tracking.stages import Stages
from bench.tracking.targets import Target
from drivers.scenes.panorama import PanoramaScene
from drivers.simulated.windows import picture_of
from pipeline.messages import Scanpath

SIZE_PX = (3200, 1600)
FRAMES = 8


class Unmade(PanoramaScene):
    """A panorama whose whole picture is never made."""

    def picture(self, index: int) -> NDArray[np.uint8]:
        raise AssertionError(f"frame {index} was made whole")


@pytest.fixture(scope="module")
def clip() -> Clip:
    scene = Unmade(size_px=SIZE_PX, seed=3, objects=4)
    return Clip(
        name=ClipName(seed=3, scene="panorama"),
        size_px=SIZE_PX,
        pictures=[picture_of(scene, k) for k in range(FRAMES)],
        truths=[scene.truth(k) for k in range(FRAMES)],
        source=scene,
    )


@pytest.mark.parametrize(
    "strategy", ["full", "oracle", "spatial", "temporal", "exposure", "context"]
)
def test_every_strategy_reads_windows_and_counts_the_pixels_of_its_budget(
    clip: Clip, strategy: str
) -> None:
    how = acquisition(strategy, Fraction(1, 8), SIZE_PX)
    camera = Camera(clip, how)
    width, height = how.sampling.roi_px
    ball = clip.truths[FRAMES - 1].boxes[0]

    context, roi = camera.expose(FRAMES - 1, 0, (0, 0, width, height), ball)

    read_px, full_px = camera.counted()
    assert read_px / full_px == pytest.approx(float(how.budget), rel=0.01)
    assert context.window == (0, 0, *SIZE_PX)
    assert context.pixels.size + roi.pixels.size < 3 * SIZE_PX[0] * SIZE_PX[1] / 4


def test_full_resolution_shows_the_object_and_its_surroundings_as_the_picture_has_them(
    clip: Clip,
) -> None:
    camera = Camera(clip, acquisition("full", Fraction(1), SIZE_PX))
    box = clip.truths[2].boxes[1]

    _, roi = camera.expose(2, 2, (0, 0, 0, 0), box)

    left, top, right, bottom = roi.window
    whole = PanoramaScene(size_px=SIZE_PX, seed=3, objects=4).picture(2)
    assert (left <= box[0], top <= box[1], right >= box[2], bottom >= box[3]) == (True,) * 4
    np.testing.assert_array_equal(roi.pixels, whole[top:bottom, left:right])


def test_a_longer_exposure_is_the_mean_of_its_windows(clip: Clip) -> None:
    camera = Camera(clip, acquisition("exposure", Fraction(1, 8), SIZE_PX))
    box = clip.truths[7].boxes[1]

    _, roi = camera.expose(7, 0, (0, 0, 0, 0), box)

    left, top, right, bottom = roi.window
    scene = PanoramaScene(size_px=SIZE_PX, seed=3, objects=4)
    parts = [scene.picture(k)[top:bottom, left:right].astype(np.float32) for k in range(8)]
    np.testing.assert_allclose(roi.pixels, np.mean(parts, axis=0), atol=0.51)


def test_the_whole_pitch_is_a_clip_of_windows() -> None:
    (name,) = names("whole_pitch:5", 1)

    clip = read(name, (1, 3))

    assert (str(name), clip.size_px, clip.windowed) == ("whole_pitch-5", (7680, 4320), True)
    assert "ball" in clip.truths[0].labels
    clip.close()


def test_contexts_are_made_once_for_all_strategies_up_to_a_limit(clip: Clip) -> None:
    one = 3 * 800 * 400  # bytes
    kept = Kept(most_bytes=3 * one + 10)
    oracle, context = (
        Camera(clip, acquisition(name, Fraction(1, 8), SIZE_PX), kept)
        for name in ("oracle", "context")
    )

    first = [oracle.context(frame).pixels for frame in range(5)]
    again = [context.context(frame).pixels for frame in range(5)]

    assert [a is b for a, b in zip(first, again, strict=True)] == [True] * 3 + [False] * 2
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert kept.nbytes == 3 * one

    spatial = Camera(clip, acquisition("spatial", Fraction(1, 32), SIZE_PX), kept)
    small = spatial.context(0).pixels
    assert kept.nbytes == small.nbytes  # the size that was longest unused made room
    assert spatial.context(0).pixels is small


def test_panoramas_are_clips() -> None:
    assert [str(name) for name in names("panorama:5", 2)] == ["panorama-5", "panorama-6"]


def test_a_cue_brings_the_tracker_to_another_object_as_with_whole_pictures() -> None:
    scene = PanoramaScene(size_px=(1600, 800), seed=3, objects=4)
    frames = range(12)
    truths = [scene.truth(k) for k in frames]
    own, other = (np.stack([truth.boxes[n] for truth in truths]) for n in (0, 1))
    seen = np.ones(len(frames), np.float32)
    target = Target(kind="ball", id=0, boxes=own, visible=seen, state=("free",) * len(frames))
    found = []

    for pictures, source in (
        ([picture_of(scene, k) for k in frames], scene),
        ([scene.picture(k).copy() for k in frames], None),
    ):
        name = ClipName(seed=3, scene="panorama")
        made = Clip(name=name, size_px=(1600, 800), pictures=pictures, truths=truths, source=source)
        camera = Camera(made, acquisition("full", Fraction(1), (1600, 800)))
        shown = [
            Scanpath(
                header=camera.header(k), ids=np.array([7], np.int32),
                probability=np.ones((1, 1), np.float32), choice=np.array([7], np.int32),
                boxes=other[k + 1][None], first_seq=k + 1,
            )
            for k in frames[:-1]
        ]  # fmt: skip
        with Stages(GRAPH, policy="pursuit") as stages:
            rules = Rules(cue=True)
            cue = Cue(start=0, plans=shown)
            loop = Loop(camera=camera, stages=stages, rules=rules, cue=cue)
            outcome = run(loop, target, 0)
        found.append((outcome.iou, outcome.away_px))

    (ious, away), (whole_ious, whole_away) = found
    assert ious[0] > 0.5  # on its object
    assert max(ious[2:]) == 0  # then on the cue's, without a frame between them
    assert max(away) < np.inf
    np.testing.assert_allclose(ious, whole_ious, atol=0.02)
    np.testing.assert_allclose(away, whole_away, atol=1.0)
