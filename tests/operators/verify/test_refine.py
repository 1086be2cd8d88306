"""Refine: what the ROI shows at full resolution corrects the detections of the context."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.verify import Refine
from pipeline import Detections, Frame, SettingsError
from pipeline.contract import settings_of
from pipeline.settings import build
from pipeline.testing import drive
from tests.operators.verify.made_up import detections, roi

PERSON = ("player", 0.9, 600.0, 400.0, 100.0)


def refined(
    context: Detections, closer: Detections | None, frame: Frame | None = None, **values: Any
) -> Detections:
    together: dict[str, Any] = {"detections": context, "closer": closer, "roi": frame or roi()}
    (answer,) = drive(Refine, [together], values)
    assert isinstance(answer, Detections)
    return answer


def test_a_candidate_that_the_roi_shows_has_its_place_and_score() -> None:
    context = detections(PERSON, ("ball", 0.2, 700, 400, 16))

    found = refined(context, detections(("ball", 0.6, 706, 404, 11)))

    assert found.scores.tolist() == pytest.approx([0.9, 0.6])
    assert found.boxes[1].tolist() == [700.5, 398.5, 711.5, 409.5]
    assert found.boxes[0].tolist() == context.boxes[0].tolist()


def test_a_candidate_that_the_roi_does_not_show_counts_less() -> None:
    context = detections(PERSON, ("ball", 0.2, 700, 400, 16), ("ball", 0.2, 100, 100, 16))

    found = refined(context, detections())

    assert found.scores.tolist() == pytest.approx([0.9, 0.06, 0.2])


def test_what_only_the_roi_shows_is_added() -> None:
    found = refined(detections(PERSON), detections(("ball", 0.5, 700, 400, 12)))

    assert [found.names[label] for label in found.labels] == ["player", "ball"]
    assert found.features.shape == (2, 2)


def test_at_the_edge_of_the_roi_nothing_is_held_against_a_candidate() -> None:
    context = detections(PERSON, ("ball", 0.2, 490, 400, 16))

    assert refined(context, detections()).scores.tolist() == pytest.approx([0.9, 0.2])


@pytest.mark.parametrize("size_px", [4.0, 30.0])
def test_what_is_too_small_or_large_beside_people_is_no_ball(size_px: float) -> None:
    found = refined(detections(PERSON), detections(("ball", 0.9, 700, 400, size_px)))

    assert len(found.scores) == 1


def test_without_people_any_size_counts() -> None:
    assert len(refined(detections(), detections(("ball", 0.9, 700, 400, 30))).scores) == 1


def test_people_whom_the_roi_shows_change_nothing() -> None:
    context = detections(PERSON)

    found = refined(context, detections(("player", 0.95, 610, 410, 90)))

    assert found.boxes.tolist() == context.boxes.tolist()


def test_an_exposure_without_a_roi_leaves_the_detections_as_they_are() -> None:
    context = detections(PERSON, ("ball", 0.2, 700, 400, 16))

    assert refined(context, None).scores.tolist() == context.scores.tolist()


BALLS = st.lists(
    st.tuples(
        st.just("ball"),
        st.floats(0, 1, width=32),
        st.floats(0, 1920, width=32),
        st.floats(0, 1080, width=32),
        st.floats(0, 40, width=32),
    ),
    max_size=6,
)


@given(BALLS, BALLS)
def test_no_candidate_is_lost_and_no_score_leaves_its_range(
    context: list[Any], closer: list[Any]
) -> None:
    before = detections(PERSON, *context)

    found = refined(before, detections(*closer))

    assert len(before.scores) <= len(found.scores) <= len(before.scores) + len(closer)
    assert ((found.scores >= 0) & (found.scores <= 1)).all()
    assert np.isfinite(found.boxes).all()
    assert {len(getattr(found, n)) for n in ("boxes", "angles", "labels", "features")} == {
        len(found.scores)
    }


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"reach_px": -1}, "reach_px: must not be negative, got -1"),
        ({"largest": 0.01}, "largest: must be above smallest, got 0.01"),
        ({"least_score": 2}, "least_score: must be within 0..1, got 2"),
    ],
)
def test_wrong_settings_are_told_in_a_sentence(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        build(settings_of(Refine), values, "refine")
