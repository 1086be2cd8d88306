"""The simulated sensor: the contract, Eq. 1, budgets, settings."""

import threading
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.sensor import Exposure
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from drivers.simulated.coverage import Coverage
from drivers.simulated.simulated import MOST_LABELS
from pipeline.errors import DriverError, PoolExhausted
from tests.drivers.contract import check_sensor, command, memory, read, refuse, started
from tests.drivers.moving_square import MovingSquare

HERE = "tests.drivers.moving_square"


def sensor(**settings: Any) -> SimulatedSensor:
    values: dict[str, Any] = {"scene": f"{HERE}:MovingSquare", "frames": 40} | settings
    return SimulatedSensor(SimulatedSensorSettings(**values))


def play(subject: SimulatedSensor) -> list[Exposure]:
    started(subject)
    exposures = []
    while (exposure := subject.read(memory)) is not None:
        exposures.append(exposure)
    subject.close()
    return exposures


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"mosaic": True},
        {"mosaic": True, "pixel_format": "bayer_gbrg10p", "full_well_e": 9000.0},
        {"step_px": 16},
        {"latency_frames": 2},
        {"noise": 2.0},
        {"source": f"{HERE}:MovingSquare", "scene": ""},
        {"roi_scale": 0.5},
        {"loop": True, "frames": 0},
        {"rois": 2, "roi_area": 0.03},
        {"rois": 4, "roi_area": 0.015, "mosaic": True, "latency_frames": 1},
    ],
)
def test_it_keeps_the_contract_of_a_sensor(settings: dict[str, Any]) -> None:
    before = MovingSquare.open_sources
    check_sensor(lambda: sensor(**settings))

    assert MovingSquare.open_sources == before


def test_context_is_area_downsampling_and_roi_a_crop_of_the_same_picture() -> None:
    subject = started(sensor())
    shown = read(subject)
    subject.close()

    source = MovingSquare()
    picture = source.picture(0)
    source.close()
    area = cv2.resize(picture, (80, 48), interpolation=cv2.INTER_AREA)
    left, top, right, bottom = shown.roi.window
    assert np.array_equal(shown.context.pixels, area)
    assert np.array_equal(shown.roi.pixels, picture[top:bottom, left:right])


def test_a_mosaic_keeps_one_colour_per_pixel_in_the_sensors_phase() -> None:
    subject = started(sensor(mosaic=True))
    shown = read(subject).roi
    subject.close()

    source = MovingSquare()
    left, top, right, bottom = shown.window
    crop = source.picture(0)[top:bottom, left:right]
    source.close()
    assert shown.pixel_format == "bayer_rggb8"
    assert np.array_equal(shown.pixels[0::2, 0::2], crop[0::2, 0::2, 0])
    assert np.array_equal(shown.pixels[0::2, 1::2], crop[0::2, 1::2, 1])
    assert np.array_equal(shown.pixels[1::2, 0::2], crop[1::2, 0::2, 1])
    assert np.array_equal(shown.pixels[1::2, 1::2], crop[1::2, 1::2, 2])


def test_lockstep_gives_the_same_bytes_for_the_same_seed() -> None:
    def run(seed: int) -> list[bytes]:
        exposures = play(sensor(noise=3.0, seed=seed, frames=5))
        return [e.context.pixels.tobytes() + e.roi.pixels.tobytes() for e in exposures]

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_noise_has_the_strength_that_was_asked_for() -> None:
    (quiet,) = play(sensor(frames=1))
    (noisy,) = play(sensor(frames=1, noise=3.0))

    middle = (quiet.roi.pixels > 30) & (quiet.roi.pixels < 190)
    difference = noisy.roi.pixels.astype(float) - quiet.roi.pixels
    assert difference[middle].std() == pytest.approx(3.0, rel=0.1)
    assert difference[middle].mean() == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(
    ("strategy", "budget"),
    [
        ("foveated", 1 / 8),
        ("centred", 1 / 8),
        ("round_robin", 1 / 8),
        ("oracle", 1 / 8),
        ("spatial", 1 / 4),
        ("spatial", 1 / 8),
        ("spatial", 1 / 16),
        ("temporal", 1 / 4),
        ("temporal", 1 / 8),
        ("temporal", 1 / 3),
        ("exposure", 1 / 8),
    ],
)
def test_every_strategy_spends_its_budget_to_one_percent(strategy: Any, budget: float) -> None:
    size_px = (640, 360)
    subject = sensor(strategy=strategy, budget=budget, size_px=size_px, frames=48)
    exposures = play(subject)

    emitted = sum(e.context.pixels[..., 0].size + e.roi.pixels[..., 0].size for e in exposures)
    assert emitted / (640 * 360 * 48) == pytest.approx(budget, rel=0.01)
    assert subject.summary()["pixels"] == {
        "budget": budget,
        "used": pytest.approx(budget, rel=0.01),
    }


def test_full_emits_everything_and_no_roi() -> None:
    subject = sensor(strategy="full", frames=3)
    exposures = play(subject)

    assert all(e.context.pixels.shape == (192, 320, 3) for e in exposures)
    assert all(e.roi.pixels.size == 0 and e.roi.window == (0, 0, 0, 0) for e in exposures)
    assert subject.summary()["pixels"] == {"budget": 1.0, "used": 1.0}


def test_the_whole_picture_is_sent_beside_the_budget_where_it_is_asked_for() -> None:
    subject = started(sensor(full=True))

    exposure = read(subject)

    assert exposure is not None
    assert exposure.full is not None
    left, top, right, bottom = exposure.roi.window
    assert np.array_equal(exposure.full.pixels[top:bottom, left:right], exposure.roi.pixels)
    assert subject.summary()["pixels"]["used"] <= 0.126
    subject.close()


def test_temporal_leaves_frames_out_and_counts_them() -> None:
    subject = sensor(strategy="temporal", frames=24)
    exposures = play(subject)

    assert [e.header.seq for e in exposures] == [0, 8, 16]
    assert subject.summary()["frames"]["skipped"] == 14
    assert subject.summary()["frames"]["late"] == 0


@pytest.mark.parametrize(("strategy", "asked_hz"), [("centred", 40.0), ("temporal", 5.0)])
def test_the_rate_asked_for_is_that_of_exposures(strategy: Any, asked_hz: float) -> None:
    subject = sensor(strategy=strategy, rate_hz=40, frames=24)
    play(subject)

    assert subject.summary()["rate"] == {"asked_hz": asked_hz, "achieved_hz": asked_hz}


def test_the_rate_falls_by_the_exposures_that_could_not_be_made() -> None:
    subject = sensor(rate_hz=40, frames=24)
    play(subject)
    subject._exposed -= 6  # as if no memory had been left for them

    assert subject.summary()["rate"] == {"asked_hz": 40.0, "achieved_hz": 30.0}


def test_the_headline_states_the_share_inside_the_roi_where_it_is_known() -> None:
    seen, unread = sensor(strategy="oracle"), sensor(strategy="oracle")
    play(seen)
    whole = sensor(strategy="full", frames=3)
    play(whole)

    assert seen.summary()["headline"] == "share of the true boxes inside the ROI: ball 100.0%"
    assert "headline" not in unread.summary()  # nothing was read of it
    assert "headline" not in whole.summary()  # there is no ROI


def test_nothing_is_said_of_a_truth_of_which_nothing_was_exposed() -> None:
    subject = sensor(strategy="oracle", frames=24)
    play(subject)
    subject._exposed, subject._coverage = 0, Coverage()  # as if no memory had been left

    assert "headline" not in subject.summary()


def test_an_oracle_that_knows_no_object_of_its_label_is_told_as_one_in_the_middle() -> None:
    lost = sensor(strategy="oracle", oracle_label="dog")
    play(lost)

    assert lost.summary()["headline"].endswith(
        "; the oracle stayed in the middle: no dog in the truth"
    )


def test_of_many_labels_the_headline_states_the_mean() -> None:
    seen = sensor(strategy="oracle")
    play(seen)
    for number in range(MOST_LABELS):
        seen._coverage._sums[f"text {number}"], seen._coverage._frames[f"text {number}"] = 1.0, 2

    line = seen.summary()["headline"]

    assert line == "share of the true boxes inside the ROI: 55.6%, the mean of 9 labels"


def test_a_longer_exposure_is_the_mean_of_its_frames() -> None:
    (first, _) = play(sensor(strategy="exposure", budget=1 / 4, frames=8))

    source = MovingSquare()
    mean = np.mean([source.picture(k).astype(float) for k in range(4)], axis=0)
    source.close()
    assert first.header.seq == 3
    assert np.abs(first.context.pixels - mean).max() <= 0.5 + 1e-6


def test_the_oracle_keeps_its_label_inside_the_roi() -> None:
    subject = sensor(strategy="oracle")
    play(subject)

    figures = subject.summary()
    assert figures["roi_coverage"] == {"ball": pytest.approx(1.0), "mean": pytest.approx(1.0)}
    assert figures["roi_coverage_frames"] == {"ball": 40}


def test_coverage_is_the_mean_share_of_the_true_box_inside_the_roi() -> None:
    subject = sensor(strategy="centred")
    exposures = play(subject)

    source = MovingSquare()
    left, top, right, bottom = exposures[0].roi.window
    shares = []
    for k in range(40):
        x0, y0, x1, y1 = (float(v) for v in source.box(k))
        width = max(0.0, min(x1, right) - max(x0, left))
        height = max(0.0, min(y1, bottom) - max(y0, top))
        shares.append(width * height / 64)
    source.close()
    assert 0.1 < np.mean(shares) < 0.9
    assert subject.summary()["roi_coverage"]["ball"] == pytest.approx(np.mean(shares), abs=1e-5)


def test_round_robin_shows_the_whole_field_within_one_tour() -> None:
    exposures = play(sensor(strategy="round_robin", frames=16))

    seen = np.zeros((192, 320), bool)
    for exposure in exposures:
        left, top, right, bottom = exposure.roi.window
        seen[top:bottom, left:right] = True
    assert seen.all()


def test_a_command_within_the_latency_leaves_the_frame_stale() -> None:
    subject = started(sensor(latency_frames=2))
    seen = read(subject).header
    window = (0, 0, 80, 48)
    subject.set_rois(command(seen.stream, made_from=0, first=1, windows=[window] * 4))
    frames = [read(subject).roi for _ in range(4)]
    subject.close()

    assert [f.status for f in frames] == ["stale", "stale", "ok", "ok"]
    assert [f.command_seq for f in frames] == [-1, -1, 0, 0]


def test_a_frame_lost_for_lack_of_memory_is_counted_and_uses_no_pixels() -> None:
    subject = started(sensor())
    for _ in range(3):
        read(subject)
    with pytest.raises(PoolExhausted):
        subject.read(refuse)
    subject.close()

    figures = subject.summary()
    assert figures["frames"]["overrun"] == 1
    assert figures["pixels"]["used"] == pytest.approx(0.125 * 3 / 4)


def test_a_source_that_ends_before_its_length_ends_the_stream() -> None:
    assert len(play(sensor(scene=f"{HERE}:EndsEarly"))) == 5


def test_a_looped_source_begins_again() -> None:
    exposures = play(sensor(loop=True, frames=50, source=f"{HERE}:MovingSquare", scene=""))

    assert [e.header.seq for e in exposures] == list(range(50))
    assert np.array_equal(exposures[2].context.pixels, exposures[42].context.pixels)
    assert not np.array_equal(exposures[2].context.pixels, exposures[3].context.pixels)


def test_a_frame_that_cannot_be_read_raises_when_it_is_reached() -> None:
    subject = started(sensor(scene=f"{HERE}:Unreadable"))
    for _ in range(3):
        read(subject)

    with pytest.raises(DriverError, match="frame 3 cannot be read"):
        subject.read(memory)
    subject.close()


def test_stop_wakes_a_reader_that_waits_for_the_next_exposure() -> None:
    subject = started(sensor(rate_hz=0.05), realtime=True)
    read(subject)
    threading.Timer(0.05, subject.stop).start()

    assert subject.read(memory) is None
    subject.close()


def test_a_recording_of_another_size_is_refused() -> None:
    subject = sensor(scene="", source=f"{HERE}:MovingSquare", size_px=(640, 384))
    before = MovingSquare.open_sources

    with pytest.raises(DriverError, match="expected 640x384 as size_px says, got 320x192"):
        subject.open(realtime=False)
    subject.close()
    assert MovingSquare.open_sources == before


def test_reading_before_it_is_started_is_refused() -> None:
    subject = sensor()

    with pytest.raises(DriverError, match="read needs start"):
        subject.read(memory)
    with pytest.raises(DriverError, match="not open"):
        subject.capabilities()
