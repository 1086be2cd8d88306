"""The shipped policy that reads: it fits the shipped detector, and shows what is unread."""

import numpy as np
import pytest

from operators.policy import ReadingPolicy, ReadingPolicySettings
from operators.policy.reading.network import SHIPPED, ReadingNetwork
from operators.saliency import SaliencySettings
from pipeline import SettingsError
from pipeline.boxes import covered
from pipeline.contract import BEFORE
from pipeline.errors import WeightsError
from pipeline.testing import drive
from tests.operators.policy.made_up_texts import reading, roi, tracks

SIGN, OTHER = (1, 300.0, 200.0, 20.0), (2, 1000.0, 500.0, 18.0)
CHANNELS = ReadingNetwork(SHIPPED).context_channels


def test_the_shipped_network_fits_the_shipped_detector_of_texts() -> None:
    detector = SaliencySettings(weights="text")

    assert list(ReadingPolicy.advise(ReadingPolicySettings(), {BEFORE: (detector,)})) == []


def test_another_detector_is_refused_before_the_run() -> None:
    class Other:
        feature_channels = 3

    with pytest.raises(SettingsError, match=r"reads 64 features of each text, .* got one with 3"):
        list(ReadingPolicy.advise(ReadingPolicySettings(), {BEFORE: (Other(),)}))


def test_each_of_two_texts_is_shown_soon() -> None:
    subject, seen = ReadingPolicy(ReadingPolicySettings()), set()
    subject.open()
    for seq in range(6):
        world = tracks(seq, SIGN, OTHER, channels=CHANNELS)
        window = subject.on_tracks(world).boxes[0]
        subject.on_roi(roi(seq, window))
        seen |= {int(i) for i in world.ids[covered(world.predicted[:, 0], window) == 1]}

    assert seen == {1, 2}


def test_what_was_read_gives_way_to_what_was_not() -> None:
    world = tracks(0, SIGN, OTHER, channels=CHANNELS)
    for read, unread in ((0, 1), (1, 0)):
        told = {"percept": reading(0, world.boxes[read : read + 1, -1], 0.95)}
        following = tracks(1, SIGN, OTHER, channels=CHANNELS)

        path = drive(ReadingPolicy, [world, told, following])[-1]

        shown = [covered(following.predicted[unread][None, k], path.boxes[k])[0] for k in (0, 1)]
        assert max(shown) == 1


def test_a_choice_that_is_drawn_is_the_same_for_the_same_seed() -> None:
    world = tracks(0, SIGN, OTHER, channels=CHANNELS)

    first, again = (
        drive(ReadingPolicy, [world], {"selection": "sample", "seed": 4})[0].choice
        for _ in range(2)
    )

    np.testing.assert_array_equal(first, again)


def test_settings_that_do_not_fit_the_network_are_refused() -> None:
    with pytest.raises(WeightsError, match="expected horizon 8 and observed 4"):
        drive(ReadingPolicy, [tracks(0, SIGN, channels=CHANNELS)], {"horizon": 8})
    with pytest.raises(SettingsError, match="observed: must be at least 1, got 0"):
        ReadingPolicySettings(observed=0)
    with pytest.raises(SettingsError, match="seed: must be at least 0, got -1"):
        ReadingPolicySettings(seed=-1)
