"""A training's log resumes at its checkpoint; the learning rate rises, then falls."""

from pathlib import Path

import pytest

from operators.training.log import note, shorten
from operators.training.schedule import warmed_cosine
from tests.full_disk import full_disk


def test_lines_after_the_checkpoint_are_removed(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    for step in (20, 40, 60):
        note(log, step, step / 10, {"loss": 0.5, "utility": 1 / 3})

    shorten(log, 40)

    header = "step,elapsed_s,loss,utility\n"
    assert log.read_text() == f"{header}20,2,0.5000,0.3333\n40,4,0.5000,0.3333\n"


def test_a_training_that_begins_anew_begins_its_log_anew(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("step,elap")  # incomplete

    shorten(log, 0)
    note(log, 20, 2.0, {"loss": 0.5})

    assert log.read_text() == "step,elapsed_s,loss\n20,2,0.5000\n"


def test_an_incomplete_line_is_removed(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("step,elapsed_s,loss\n20,2,0.5000\n\x00\x00")

    shorten(log, 20)

    assert log.read_text() == "step,elapsed_s,loss\n20,2,0.5000\n"


def test_a_line_that_ends_early_or_comes_again_is_removed(tmp_path: Path) -> None:
    log, whole = tmp_path / "log.csv", "step,elapsed_s,loss\n0,0,0.6000\n20,2,0.5000\n"
    for torn in ("20,3,0.4000\n12\n30,4", "40,4,", "40,4,0.4"):  # the last may be of 0.4000
        log.write_text(f"{whole}{torn}")

        shorten(log, 40)

        assert log.read_text() == whole


def test_lines_below_a_header_that_was_torn_stay(tmp_path: Path) -> None:
    log, lines = tmp_path / "log.csv", "20,2,0.5000\n40,4,0.4000\n"
    log.write_text(f"step,ela\n{lines}")

    shorten(log, 40)

    assert log.read_text() == f"step,ela\n{lines}"


def test_a_log_that_cannot_be_shortened_stays_whole(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    for step in range(20, 10_000, 20):
        note(log, step, step / 10, {"loss": 0.5})
    whole = log.read_text()

    with pytest.raises(OSError, match=r"log\.csv"), full_disk(2000):
        shorten(log, 9_000)

    assert log.read_text() == whole


def test_a_missing_log_is_not_created(tmp_path: Path) -> None:
    shorten(tmp_path / "log.csv", 40)

    assert not (tmp_path / "log.csv").exists()


def test_the_rate_rises_then_falls() -> None:
    rates = [warmed_cosine(step, peak=1.0, warmup=10, steps=100) for step in range(100)]

    assert rates.index(max(rates)) == 9
    assert rates[0] == pytest.approx(0.1)
    assert rates[-1] < 0.02
