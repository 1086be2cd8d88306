"""The policy that acts: its windows, its rule, a swap, and inputs that it refuses."""

from pathlib import Path

import numpy as np
import pytest

from operators.acting import ActingPolicy, ActingPolicySettings
from pipeline import MessageError, SettingsError, WeightsError
from tests.operators.acting.samples import context, header, joints, network, roi, tracks

Box = tuple[int, int, int, int]
START: Box = 0, 0, 160, 120  # shows nothing of the workplace


def policy(**settings: object) -> ActingPolicy:
    subject = ActingPolicy(ActingPolicySettings(**settings))  # type: ignore[arg-type]
    subject.open()
    return subject


def followed(subject: ActingPolicy, frames: int, window: Box = START) -> list[Box]:
    """Close the loop over the sensor alone; return the windows that were shown next."""
    found = []
    for seq in range(frames):
        plan = subject.on_tracks_context_roi_joints(
            tracks([[300, 250, 340, 280]], seq), context(seq), roi(window, seq), joints(seq)
        )
        left, top, right, bottom = (int(side) for side in plan.boxes[0])
        window = left, top, right, bottom
        found.append(window)
    return found


def test_in_turn_every_place_is_shown_before_one_is_shown_again() -> None:
    shown = followed(policy(choose="turn"), 12)

    assert len(set(shown[:6])) == 6
    assert set(shown[6:]) == set(shown[:6])


def test_a_plan_goes_on_as_the_next_ones_do() -> None:
    subject, window = policy(choose="turn", horizon=4), START
    ahead = subject.on_tracks_context_roi_joints(tracks([]), context(), roi(window), joints()).boxes

    assert [tuple(int(v) for v in box) for box in ahead] == followed(policy(choose="turn"), 4)


def test_a_successor_goes_on_with_the_round() -> None:
    subject, whole = policy(choose="turn"), followed(policy(choose="turn"), 6)
    first = followed(subject, 3)
    successor = policy(choose="turn")
    successor.restore(subject.state())

    plan = successor.on_tracks_context_roi_joints(
        tracks([], 3), context(3), roi(first[-1], 3), joints(3)
    )

    assert tuple(plan.boxes[0]) == whole[3]


def test_what_was_shown_is_kept_over_a_swap_and_not_over_a_new_stream() -> None:
    subject = policy(choose="turn")
    followed(subject, 3)
    successor = policy(choose="turn")
    successor.restore(subject.state())
    kept = int(successor.state().known.sum())

    successor.on_stream(header(stream="next"))

    assert kept > 0
    assert successor.state().known.size == 0


def test_numbers_that_are_not_finite_hide_only_their_track() -> None:
    broken = tracks([[300, 250, 340, 280], [200, 200, 240, 240]])
    broken.predicted[0] = np.nan

    plan = policy(choose="turn").on_tracks_context_roi_joints(
        broken, context(), roi(START), joints()
    )

    assert plan.ids.tolist() == [4]
    assert np.isfinite(plan.boxes).all()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"workplace": (0.5, 0, 0.2, 1)}, "workplace: expected four shares"),
        ({"horizon": 0}, "horizon: expected 1 to"),
        ({"change_levels": -1.0}, "change_levels: expected 0 to 255"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(SettingsError, match=told):
        ActingPolicySettings(**settings)  # type: ignore[arg-type]


def test_another_detector_and_other_arms_are_refused_in_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="needs the train extra")
    subject = policy(weights=str(network(tmp_path / "a.onnx", channels=2)))
    given = context(), roi(START)

    with pytest.raises(MessageError, match="expects 2 features of each object, got 5"):
        subject.on_tracks_context_roi_joints(tracks([], channels=5), *given, joints())
    with pytest.raises(MessageError, match="expected 14 joints, got 6"):
        subject.on_tracks_context_roi_joints(tracks([]), *given, joints(count=6))


def test_a_file_that_is_no_such_network_is_refused(tmp_path: Path) -> None:
    from operators.saliency.saliency import SaliencySettings

    other = SaliencySettings(weights="objects").detector.path

    with pytest.raises(WeightsError, match="expected inputs facts"):
        policy(weights=str(other))
