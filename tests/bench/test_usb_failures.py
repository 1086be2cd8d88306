"""Injected failures: every exposure arrives or is lost for a reason that the driver counted."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.usb.injection import injected
from bench.usb.reasons import Loss, NotedLosses, explained
from bench.usb_failures import CASES, Case, drawn, injections, main, quiet, row

RATE_HZ = 400.0


def case(name: str) -> Case:
    return next(one for one in CASES if one.name == name)


def loss(reason: str, exposure: int = -1, count: int = 1) -> Loss:
    return Loss(reason=reason, exposure=exposure, count=count)


def test_what_the_driver_did_not_count_stays_unexplained() -> None:
    assert explained([3, 4, 5], [loss("header")]) == {"header": 1}


def test_a_loss_that_names_its_exposure_explains_no_other() -> None:
    assert explained([8], [loss("checksum", 7), loss("unpaired", 9)]) == {}
    assert explained([7, 8], [loss("checksum", 7), loss("unpaired", 7)]) == {"checksum": 1}


def test_frames_that_the_board_dropped_lie_before_the_exposure_that_says_so() -> None:
    assert explained([3, 4, 9], [loss("dropped", 5, count=7)]) == {"dropped": 2}
    assert explained([3, 4], [loss("dropped", 5), loss("checksum", 4)]) == {"dropped": 1}


def test_a_stall_explains_one_exposure_and_an_outage_all_that_are_left() -> None:
    assert explained([1, 2], [], stalls=1) == {"stall": 1}
    assert explained([1, 2, 0, 1], [loss("link")], outage=True) == {"link": 1, "outage": 3}


def test_the_driver_says_which_exposure_it_lost() -> None:
    losses = NotedLosses()

    losses.lose("checksum", "roi of exposure 12: expected the checksum 1, got 2")
    losses.lose("header", "roi: looking for the next frame")

    assert losses.noted == [loss("checksum", 12), loss("header")]
    assert losses == {"checksum": 1, "header": 1}


@pytest.mark.parametrize(
    "name", [one.name for one in CASES if one.name not in ("silence for ever", "silence")]
)
def test_nothing_is_unexplained_or_wrong_after_a_failure(name: str) -> None:
    with quiet():
        found = row(case(name), injections(case(name), 2, RATE_HZ, seed=1))

    assert found["times"] == 2
    assert found["unexplained"] == 0, found
    assert found["wrong"] == 0
    assert found["recovered"] + found["ended_with_error"] == 2
    assert found["exposed"] >= found["delivered"] > 0


def test_a_failure_costs_frames_that_are_counted() -> None:
    with quiet():
        found = injected([{"kind": "truncate", "exposure": 8}], rate_hz=RATE_HZ)

    assert found.lost["incomplete"] == 1
    assert found.exposed == found.delivered + sum(found.lost.values())
    assert 0 < found.recovered_ms < 5000
    assert not found.error


def test_numbers_that_passed_in_silence_were_never_exposed() -> None:
    faults = [{"kind": "silence", "exposure": 8, "seconds": 0.2}]

    with quiet():
        found = injected(faults, rate_hz=RATE_HZ, lasting_s=0.2)

    assert found.never_exposed >= 60
    assert found.unexplained == 0


def test_numbers_that_passed_while_the_board_was_away_were_never_exposed() -> None:
    faults = [{"kind": "unplug", "exposure": 8, "seconds": 0.2}]

    with quiet():
        found = injected(faults, rate_hz=RATE_HZ, lasting_s=0.2)

    assert found.never_exposed >= 60
    assert found.exposed == found.delivered + sum(found.lost.values())


def test_without_a_failure_nothing_is_said_or_lost() -> None:
    told = []
    for _ in range(3):  # a machine that stands still for longer than the board can wait loses some
        with quiet():
            found = injected([], rate_hz=RATE_HZ / 20, pause_s=0.0, pause_at=5)
        assert (found.error, found.unexplained) == ("", 0)
        told.append(found.sentences)
        if not found.sentences:
            break

    assert told[-1] == [], told


def test_the_same_seed_draws_the_same_failures() -> None:
    pulled = case("cable pulled")

    first, again, other = ([drawn(pulled, seed, k) for k in range(9)] for seed in (1, 1, 2))

    assert first == again != other
    assert all(5 <= at < 25 and 0.02 <= lasting_s <= 0.5 for at, lasting_s in first)


def test_the_command_writes_what_became_of_every_exposure(tmp_path: Path) -> None:
    path = tmp_path / "failures.json"
    words = ["--count", "2", "--only", "frame missing, ROI", "--rate-hz", "400",
             "--json", str(path)]  # fmt: skip

    done = CliRunner().invoke(main, words, catch_exceptions=False)

    assert done.exit_code == 0, done.output
    report = json.loads(path.read_text())
    assert (report["injected"], report["unexplained"], report["delivered_wrong"]) == (2, 0, 0)
    assert "lost, unpaired" in report["failures"][0]["driver"]


def test_an_unknown_failure_is_refused_with_the_names() -> None:
    done = CliRunner().invoke(main, ["--only", "rain"])

    assert done.exit_code == 2
    assert "cable pulled" in done.output
    assert "got rain" in done.output
