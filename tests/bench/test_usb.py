"""The bench of the USB driver: prepared pictures, places of memory, accounts, and a small run."""

import json
import mmap
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.usb.backend import RingBackend, RingSettings
from bench.usb.paced import PacedLink
from bench.usb.places import Places
from bench.usb.ring import prepared
from bench.usb.stream import by_frame, copies, drops, frame_bytes, main, rate_of
from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.usb.link import CHUNK_BYTES
from drivers.virtual_board.profiles import PROFILES
from pipeline.errors import DriverError, SettingsError
from pipeline.pixel_formats import FORMATS
from tests.drivers.contract import command, read, started

SIZE_PX, CONTEXT_PX = (2560, 1440), (320, 180)
BACKEND = "bench.usb.backend:RingBackend"
EIGHT = FORMATS["bayer_rggb8"]


def ring_board(log: str = "", **settings: object) -> DualStreamBoard:
    options = {"size_px": SIZE_PX, "ring": 2, "log": log, "unlimited": True}
    return DualStreamBoard(
        DualStreamBoardSettings(
            rate_hz=100.0, pixel_format=EIGHT.name, backend=BACKEND, backend_options=options,
            **settings,  # type: ignore[arg-type]
        )
    )  # fmt: skip


def test_a_prepared_window_shows_what_the_context_shows_there() -> None:
    (found,) = prepared(EIGHT, SIZE_PX, CONTEXT_PX, count=1, seed=3)

    small = found.field.reshape(180, 8, 320, 8).mean(axis=(1, 3))  # grey of each cell
    context = found.context.astype(np.float64)
    cells = [a.reshape(90, 2, 160, 2).mean(axis=(1, 3)) for a in (small, context)]
    assert found.field.shape == (1440, 2560)
    assert np.corrcoef(*(c.ravel() for c in cells))[0, 1] > 0.9


def test_sixteen_bits_use_the_whole_range() -> None:
    pictures = [
        prepared(FORMATS[name], SIZE_PX, CONTEXT_PX, count=1, seed=3)[0].context
        for name in ("bayer_rggb8", "bayer_rggb16")
    ]

    assert np.abs(pictures[1] / 257 - pictures[0]).max() <= 1


def test_a_packed_format_is_refused() -> None:
    with pytest.raises(DriverError, match="a mosaic that is not packed, got bayer_rggb12p"):
        prepared(FORMATS["bayer_rggb12p"], SIZE_PX, CONTEXT_PX, count=1, seed=3)


def test_the_ring_keeps_the_order_of_colours_and_shows_the_commanded_window() -> None:
    subject = started(ring_board())
    first = read(subject)
    window = (16, 32, 656, 392)
    stream, seq = first.header.stream, first.header.seq
    subject.set_rois(command(stream, made_from=seq, first=seq + 1, windows=[window] * 2))
    second = read(subject)
    subject.close()

    fields = prepared(EIGHT, SIZE_PX, CONTEXT_PX, count=2, seed=0)
    left, top, right, bottom = second.roi.window
    assert (left, top) == (16, 32)
    assert second.roi.pixel_format == EIGHT.name
    assert np.array_equal(second.roi.pixels, fields[1].field[top:bottom, left:right])
    assert np.array_equal(first.context.pixels, fields[0].context)


def test_a_ring_out_of_range_is_refused() -> None:
    with pytest.raises(SettingsError, match="ring: expected 0 to 64, got 65"):
        RingSettings(ring=65)


def test_the_backend_writes_down_where_each_frame_was_put(tmp_path: Path) -> None:
    log = tmp_path / "board.json"
    subject = started(ring_board(str(log)))
    exposures = [read(subject) for _ in range(3)]
    subject.close()

    told = json.loads(log.read_text())
    frames = by_frame(told["frames"])
    sizes = {name: count for (name, _), (_, count) in frames.items()}
    assert sorted(frames) == [(name, k) for name in ("context", "roi") for k in range(3)]
    assert sizes["roi"] == exposures[0].roi.pixels.nbytes
    assert told["board"]["cpu_percent"] > 0
    assert told["board"]["reads"] >= 12


def test_the_place_of_shared_memory_is_the_same_through_any_mapping(tmp_path: Path) -> None:
    file = tmp_path / "pool"
    file.write_bytes(bytes(1 << 16))
    handle = os.open(file, os.O_RDWR)
    views = [np.frombuffer(mmap.mmap(handle, 1 << 16), np.uint8) for _ in range(2)]
    os.close(handle)
    places = Places()

    one, other = (places.of(view[4096:].ctypes.data) for view in views)

    assert views[0].ctypes.data != views[1].ctypes.data
    assert one == other
    assert one.endswith("+4096")
    assert places.of(views[0][4097:].ctypes.data) != one


def test_memory_without_a_file_has_no_place() -> None:
    assert Places().of(np.empty(1 << 24, np.uint8).ctypes.data) == ""


def test_a_frame_that_lies_elsewhere_or_nowhere_counts_as_copied() -> None:
    written = {("roi", 1): ("0:1 7 +0", 9), ("roi", 2): ("0:1 7 +9", 9), ("roi", 3): ("", 9)}
    arrived = {("roi", 1): ("0:1 7 +0", 9), ("roi", 2): ("0:1 7 +0", 9), ("roi", 3): ("", 9),
               ("roi", 4): ("0:1 7 +0", 9)}  # fmt: skip

    assert copies(written, arrived) == {"compared": 3, "in_place": 1, "copied": 2}


def test_lost_exposures_without_a_reason_are_unexplained() -> None:
    written = [("roi", 4, "", 9), ("context", 3, "", 9)]
    report = {"frames": {"exposed": 50, "lost": 6, "overrun": 1}, "losses": {"dropped": 7}}

    assert drops(report, written) == {
        "delivered": 50, "before_the_first": 3, "dropped": 7, "lost": 6, "overrun": 1,
        "reason_dropped": 7, "unexplained": 2,
    }  # fmt: skip


def test_the_rate_is_what_the_link_carries_of_both_pictures() -> None:
    can = PROFILES["paper-live"].can

    both = 2040 * 1148 + 4080 * 2296
    assert frame_bytes(can, EIGHT) == both
    assert rate_of(can, EIGHT) == 30.0
    assert rate_of(can, FORMATS["bayer_rggb16"]) == int(400e6 / (2 * both) * 1000) / 1000


CHUNK_NS = 1310720  # 512 KiB at 400 MB/s


@pytest.mark.parametrize(("reads", "late_ns"), [(1, 3_000_000), (16, 0)])
def test_the_link_goes_on_while_the_host_is_late_if_reads_are_in_flight(
    reads: int, late_ns: int
) -> None:
    link = PacedLink(400_000_000, reads)
    first_ns = link.until_ns(CHUNK_BYTES, asked_ns=1_000_000, ready_ns=1_000_000)
    link.returned(first_ns)

    second_ns = link.until_ns(CHUNK_BYTES, asked_ns=first_ns + 3_000_000)

    assert first_ns == 1_000_000 + CHUNK_NS
    assert second_ns == first_ns + late_ns + CHUNK_NS
    assert list(link.gaps_ms()) == [late_ns / 1e6]


def test_the_link_is_ahead_of_the_host_by_as_many_reads_as_are_in_flight() -> None:
    link = PacedLink(400_000_000, 2)
    link.until_ns(CHUNK_BYTES, asked_ns=1, ready_ns=1)
    link.returned(CHUNK_NS)
    link.until_ns(CHUNK_BYTES, asked_ns=1)
    link.returned(9_000_000)  # the host came late for the second one

    third_ns = link.until_ns(CHUNK_BYTES, asked_ns=9_000_000)  # submitted when the first returned
    fourth_ns = link.until_ns(CHUNK_BYTES, asked_ns=20_000_000)

    assert third_ns == 1 + 3 * CHUNK_NS
    link.returned(9_000_000)
    assert fourth_ns == third_ns + CHUNK_NS


def test_the_link_does_not_begin_a_frame_that_is_not_ready_and_does_not_wait_for_it() -> None:
    link = PacedLink(400_000_000, 16)
    link.until_ns(96, asked_ns=0, ready_ns=0)

    begun_ns = link.until_ns(96, asked_ns=0, ready_ns=5_000_000)

    assert begun_ns == 5_000_000 + 240
    assert list(link.gaps_ms()) == [0.0]


@pytest.mark.lengthy
def test_a_small_run_of_the_whole_graph_drops_and_copies_nothing(tmp_path: Path) -> None:
    path = tmp_path / "usb.json"
    words = ["--seconds", "3", "--size", "2560", "1440", "--ring", "2", "--rate-hz", "10",
             "--json", str(path)]  # fmt: skip

    done = CliRunner().invoke(main, words, catch_exceptions=False)

    assert done.exit_code == 0, done.output
    told = json.loads(path.read_text())
    assert told["copies"]["compared"] > 10
    assert told["copies"]["copied"] == 0
    assert told["frames"]["delivered"] > 15
    assert (told["frames"]["overrun"], told["frames"]["unexplained"]) == (0, 0)
    assert told["commands"]["accepted"] > 0
    stages = {row["stage"]: row for row in told["stages"]}
    assert stages["capture"]["sent_megabytes_per_s"] > 0
    assert 0 < told["board"]["share_of_its_process_percent"] <= 100


def test_the_backend_is_one_that_settings_can_name() -> None:
    assert RingBackend.settings_type is RingSettings
