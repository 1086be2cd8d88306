"""Evaluation over a source that is read by windows: the same figures as over whole pictures."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.tracking.budgets import acquisition
from bench.tracking.clip import Clip
from bench.tracking.stages import Camera, Stages
from bench.tracking.windowed import WindowedCamera, WindowedClip, whole_pitch
from pipeline.errors import RunError

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "tracking.yaml"
SIZE = (1920, 1080)
FRAMES = range(40, 50)


@pytest.fixture(scope="module")
def clip() -> WindowedClip:
    return whole_pitch(3, FRAMES, size_px=SIZE, light="floodlight")


@pytest.fixture(scope="module")
def kept(clip: WindowedClip) -> Clip:
    """The same frames as whole pictures."""
    pictures = [np.array(clip.source.picture(index)) for index in FRAMES]
    return replace(clip.clip, pictures=pictures)


@pytest.fixture(scope="module")
def stages() -> Iterator[Stages]:
    with Stages(GRAPH, policy="pursuit") as stages:
        yield stages


def followed(camera: Camera, stages: Stages, box: NDArray[np.float32]) -> list[list[float]]:
    """Return the boxes of a tracker that is started on a box in the first frame."""
    init = tuple(float(side) for side in box)
    stages.begin(camera.header(0), "tracker", tracker={"init_box": init})
    found = []
    step = camera.how.sampling.interval
    for frame in range(step - 1, len(FRAMES), step):
        if isinstance(camera, WindowedCamera):
            camera.near(box)
        context, roi = camera.expose(frame, frame - step + 1, (0, 0, 0, 0))
        percept = stages.call("tracker", context=context, roi=roi)
        box = percept.boxes[0] if len(percept.boxes) else box
        found.append([float(side) for side in box])
    return found


@pytest.mark.parametrize("strategy", ["full", "temporal", "exposure"])
def test_full_resolution_near_the_object_is_all_that_a_tracker_sees(
    clip: WindowedClip, kept: Clip, stages: Stages, strategy: str
) -> None:
    how = acquisition(strategy, Fraction(1, 4), SIZE)
    box = clip.clip.truths[0].boxes[3]

    lazy, whole = WindowedCamera(clip, how), Camera(kept, how)

    assert followed(lazy, stages, box) == followed(whole, stages, box)
    assert lazy.counted() == whole.counted()


@pytest.mark.parametrize("strategy", ["centred", "spatial"])
def test_contexts_and_regions_are_those_of_whole_pictures(
    clip: WindowedClip, kept: Clip, strategy: str
) -> None:
    how = acquisition(strategy, Fraction(1, 8), SIZE)
    lazy, whole = WindowedCamera(clip, how), Camera(kept, how)
    wide, high = how.sampling.roi_px

    for frame in (0, 7):
        windows = (101, 203, 101 + wide, 203 + high)
        mine, theirs = lazy.expose(frame, frame, windows), whole.expose(frame, frame, windows)
        np.testing.assert_array_equal(mine[1].pixels, theirs[1].pixels)
        away = np.abs(mine[0].pixels.astype(int) - theirs[0].pixels)
        assert np.quantile(away, 0.99) <= 2
        assert mine[0].window == theirs[0].window
    assert lazy.counted() == whole.counted()


def test_a_cue_is_seen_at_full_resolution_too_and_costs_no_more(
    clip: WindowedClip, kept: Clip
) -> None:
    camera = WindowedCamera(clip, acquisition("full", Fraction(1), SIZE))
    one, other = clip.clip.truths[4].boxes[[0, 20]]

    camera.near(one, other)
    context, roi = camera.expose(4, 4, (0, 0, 0, 0))

    for frame in (context, roi):
        left, top, right, bottom = frame.window
        np.testing.assert_array_equal(frame.pixels, kept.pictures[4][top:bottom, left:right])
    assert context.window != roi.window
    assert camera.emitted_px == SIZE[0] * SIZE[1]


def test_full_resolution_without_an_object_is_refused(clip: WindowedClip) -> None:
    camera = WindowedCamera(clip, acquisition("full", Fraction(1), SIZE))

    with pytest.raises(RunError, match="frame 2: full resolution needs `near` before an exposure"):
        camera.context(2)


def test_a_window_of_more_pixels_than_the_budget_has_is_refused(clip: WindowedClip) -> None:
    camera = WindowedCamera(clip, acquisition("centred", Fraction(1, 8), SIZE))

    with pytest.raises(RunError, match=r"frame 3: expected a window of \(480, 270\)"):
        camera.roi(3, (0, 0, 960, 540))


@settings(deadline=None, max_examples=30)
@given(
    corner=st.tuples(st.floats(-200, 2100), st.floats(-200, 1300)),
    sides=st.tuples(st.floats(0, 400), st.floats(0, 400)),
)
def test_full_resolution_stays_in_the_field_and_holds_the_object(
    clip: WindowedClip, corner: tuple[float, float], sides: tuple[float, float]
) -> None:
    camera = WindowedCamera(clip, acquisition("full", Fraction(1), SIZE))
    box = np.array([*corner, *np.add(corner, sides)], np.float32)

    camera.near(box)
    left, top, right, bottom = camera.context(0).window

    assert 0 <= left < right <= SIZE[0]
    assert 0 <= top < bottom <= SIZE[1]
    inside = np.clip(box, 0, [*SIZE, *SIZE])
    assert (inside[:2] >= [left, top]).all()
    assert (inside[2:] <= [right, bottom]).all()
