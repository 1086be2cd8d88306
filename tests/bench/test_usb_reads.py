"""Reads in flight: the model's link waits for a single read, and hardly for many."""

import json
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.usb.model import ModelLink, compiled
from bench.usb_reads import main, summary
from drivers.usb.frame_header import Stream
from drivers.virtual_board.usbip import CONTROLLER

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
SIZES_PX = ((64, 48), (1024, 1536))  # the second one takes three bulk reads


@needs_compiler
@pytest.mark.parametrize("depth", [1, 4])
def test_the_driver_receives_whole_frames_over_the_model(depth: int, tmp_path: Path) -> None:
    memory = [np.empty(width * height, np.uint8) for width, height in SIZES_PX]

    with ModelLink(compiled(tmp_path), SIZES_PX, depth=depth, bytes_per_s=1e9) as link:
        receiver = link.receiver()
        for _ in range(5):
            headers = receiver.headers(list(Stream), 5.0)
            assert list(headers) == list(Stream)
            assert receiver.payloads(list(zip(headers.values(), memory, strict=True)), 5.0)
        count, gaps = link.bytes, link.gaps_ms()

    assert count == 5 * (2 * 96 + sum(m.nbytes for m in memory))
    assert len(gaps) == 5 * (2 + 1 + 3) - 1
    assert gaps.min() >= 0


def waited_ms(library: Path, *, reads_ahead: bool) -> float:
    """Return how long the link waits in six exposures of 16 ms, the host busy for 10 ms in each."""
    pair = [[np.empty(w * h, np.uint8) for w, h in SIZES_PX] for _ in range(2)]
    with ModelLink(library, SIZES_PX, depth=8, bytes_per_s=1e8) as link:
        receiver = link.receiver()
        for k in range(6):
            headers = receiver.headers(list(Stream), 5.0)
            ahead = dict(zip(Stream, pair[(k + 1) % 2], strict=True)) if reads_ahead else None
            pictures = list(zip(headers.values(), pair[k % 2], strict=True))
            assert receiver.payloads(pictures, 5.0, ahead)
            time.sleep(0.01)
        return float(link.gaps_ms().sum())


@needs_compiler
def test_the_link_goes_on_while_the_host_is_busy_with_the_exposure_before(tmp_path: Path) -> None:
    library = compiled(tmp_path)

    assert waited_ms(library, reads_ahead=False) > 40
    # what else the machine does can only add to it
    tries = (waited_ms(library, reads_ahead=True) for _ in range(20))
    assert any(waited < 10 for waited in tries)


@needs_compiler
def test_what_was_read_ahead_is_given_up_when_the_driver_looks_for_a_header(
    tmp_path: Path,
) -> None:
    pair = [[np.zeros(w * h, np.uint8) for w, h in SIZES_PX] for _ in range(2)]

    with ModelLink(compiled(tmp_path), SIZES_PX, depth=8, bytes_per_s=1e8) as link:
        receiver = link.receiver()
        headers = receiver.headers(list(Stream), 5.0)
        pictures = list(zip(headers.values(), pair[0], strict=True))
        assert receiver.payloads(pictures, 5.0, dict(zip(Stream, pair[1], strict=True)))
        receiver.search()
        found: dict[Stream, object] = {}
        while len(found) < 2:
            missing = [stream for stream in Stream if stream not in found]
            found |= receiver.headers(missing, 5.0)

    assert list(found) == sorted(found)
    assert receiver.losses == {}


@needs_compiler
def test_the_command_reports_every_number_of_reads(tmp_path: Path) -> None:
    path = tmp_path / "reads.json"
    words = ["1", "4", "--seconds", "0.3", "--rounds", "1", "--json", str(path)]

    done = CliRunner().invoke(main, words, catch_exceptions=False)

    assert done.exit_code == 0, done.output
    one, four = json.loads(path.read_text())["rows"]
    assert (one["reads"], four["reads"], four["in_effect"]) == (1, 4, 4)
    assert 0 < one["megabytes_per_s"] <= 401
    assert four["gap_p50_ms"] < one["gap_p50_ms"]


def test_a_line_is_the_median_round_and_all_gaps() -> None:
    def one(rate: float, gap: float) -> dict[str, object]:
        return {"in_effect": 2, "megabytes_per_s": rate, "exposures_hz": 1.0, "lost": 1,
                "waits_percent": gap, "driver_cpu_percent": 5.0, "gaps": [gap]}  # fmt: skip

    found = summary(2, [one(10.0, 1.0), one(30.0, 3.0), one(20.0, 2.0)])

    assert found["megabytes_per_s"] == 20.0
    assert found["range_megabytes_per_s"] == "10.0 to 30.0"
    assert (found["gap_p50_ms"], found["gap_most_ms"], found["lost"]) == (2.0, 3.0, 3)


@pytest.mark.skipif(CONTROLLER.exists(), reason="this kernel has a virtual controller")
def test_without_a_kernel_with_usb_it_is_one_sentence() -> None:
    done = CliRunner().invoke(main, ["1", "--over", "usbip"])

    assert done.exit_code == 1
    assert "Error: usb" in done.output
    assert "Traceback" not in done.output
