"""Bulk reads in flight against one: throughput of the USB driver, and how long the link waits.

`python -m bench.usb_reads 1 2 4 8 16`. The board always has a frame. `--over model` runs the
driver's receiver and transfers over a modelled host controller (bench/usb/model.c) with a link of
`--link` bytes/s, so that only the driver decides whether the link waits. `--over usbip` attaches a
virtual board to this kernel (root, module vhci_hcd: see tests/guest) and runs the whole driver over
the kernel and libusb, each exposure made when it is asked for; `--over attached` does so with the
board on the desk.
"""

import json
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import DTypeLike, NDArray

from bench.machine import LIBRARIES, facts
from bench.options import JSON, Bench
from bench.results.markdown import table_of
from bench.usb.backend import RingBoard, RingSettings
from bench.usb.gauge import spread
from bench.usb.model import ModelLink, compiled
from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.usb.frame_header import Stream
from drivers.usb.link import attached
from drivers.virtual_board.usbip import detach, free_port, serve
from pipeline.errors import DriverError

LINK_BYTES_PER_S = 400_000_000  # what a USB 3.0 camera reaches
SIZES_PX = ((2040, 1148), (4080, 2296))  # the paper's context and ROI
FOUND_S = 20.0
WAIT_S = 1.0
Row = dict[str, Any]


@click.command(cls=Bench, help=__doc__)
@click.argument("reads", nargs=-1, type=click.IntRange(1, 24))
@click.option("--over", default="model", type=click.Choice(["model", "usbip", "attached"]))
@click.option("--seconds", default=5.0, show_default=True, type=click.FloatRange(0.2))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@click.option("--link", default=LINK_BYTES_PER_S, show_default=True, help="Bytes/s of the model.")
@click.option("--busy", default=0, show_default=True, help="Processes that compute meanwhile.")
@click.option(
    "--size", nargs=2, type=int, default=(0, 0), help="Of usbip's sensor, 0: the paper's."
)
@click.option("--seed", default=0, show_default=True, help="Of the order.")
@JSON
def main(
    reads: tuple[int, ...], over: str, seconds: float, rounds: int, link: int, busy: int,
    size: tuple[int, int], seed: int, path: Path | None,
) -> None:  # fmt: skip
    """Measure each number of reads, several rounds in shuffled order."""
    reads = reads or (1, 2, 4, 8, 16)
    rng = np.random.default_rng(seed)
    order = [int(n) for _ in range(rounds) for n in rng.permutation(reads)]
    found: dict[int, list[Row]] = {n: [] for n in reads}
    with ExitStack() as stack:
        measure = _way(stack, over, link, size)
        stack.enter_context(computing(busy))
        for count in order:
            found[count].append(measure(count, seconds))
    rows = [summary(count, each) for count, each in found.items()]
    result = {
        "bench": "usb_reads", **facts((*LIBRARIES, "pyusb")), "seed": seed, "over": over,
        "seconds": seconds, "rounds": rounds, "busy_processes": busy,
        "link_bytes_per_s": link if over == "model" else None,
        "size_px": list(size) if over == "usbip" else None, "rows": rows,
    }  # fmt: skip
    click.echo(table_of(rows))
    if path:
        path.write_text(json.dumps(result, indent=1) + "\n")


def _way(
    stack: ExitStack, over: str, link: int, size_px: tuple[int, int]
) -> Callable[[int, float], Row]:
    if over == "model":
        library = compiled(Path(stack.enter_context(tempfile.TemporaryDirectory())))
        return lambda depth, seconds: over_model(library, depth, seconds, link)
    if over == "usbip":
        stack.enter_context(virtual_board(size_px))
    return over_kernel


def over_model(library: Any, depth: int, seconds: float, link: int) -> Row:
    """Read frames through the driver's receiver for so long."""
    pair = [[np.empty(width * height, np.uint8) for width, height in SIZES_PX] for _ in range(2)]
    exposures = 0
    with ModelLink(library, SIZES_PX, depth=depth, bytes_per_s=link) as found:
        receiver = found.receiver()
        began_s, cpu_s = time.monotonic(), time.thread_time()
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            headers = receiver.headers(list(Stream), WAIT_S)
            pictures = list(zip(headers.values(), pair[exposures % 2], strict=True))
            ahead = dict(zip(Stream, pair[(exposures + 1) % 2], strict=True))
            if len(headers) != len(Stream) or not receiver.payloads(pictures, WAIT_S, ahead):
                raise DriverError(f"usb model: a frame did not arrive: {dict(receiver.losses)}")
            exposures += 1
        return _row(
            depth, elapsed_s, exposures, found.bytes, list(found.gaps_ms()), lost=0,
            cpu_s=time.thread_time() - cpu_s,
        )  # fmt: skip


def over_kernel(depth: int, seconds: float) -> Row:
    """Read exposures through the whole driver for so long; each is made when it is asked for.

    How long the link waits is not known there: a host controller does not tell it, and the time
    between two reads of a USB/IP device is mostly its own.
    """
    subject = _Opened(DualStreamBoardSettings(
        pixel_format="bayer_rggb8", in_flight=depth, link_bytes_per_s=1 << 40
    ))  # fmt: skip
    kept: dict[str, NDArray[Any]] = {}

    def memory(
        output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        if output not in kept or kept[output].shape != shape:
            kept[output] = np.empty(shape, dtype)
        return kept[output]

    subject.open(realtime=False)
    try:
        in_effect = subject.in_flight
        subject.start()
        subject.read(memory)
        before, began_s, cpu_s = subject.summary(), time.monotonic(), time.thread_time()
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            subject.read(memory)
        told, cpu_s = subject.summary(), time.thread_time() - cpu_s
    finally:
        subject.close()
    exposures, lost = (told["frames"][n] - before["frames"][n] for n in ("exposed", "lost"))
    count = told["link"]["bytes"] - before["link"]["bytes"]
    return _row(in_effect, elapsed_s, exposures, count, None, lost=lost, cpu_s=cpu_s)


class _Opened(DualStreamBoard):
    @property
    def in_flight(self) -> int:
        """Reads that the link keeps in flight."""
        return self._opened().connection.link.in_flight


def _row(
    in_effect: int, elapsed_s: float, exposures: int, count: int, gaps_ms: Sequence[float] | None,
    *, lost: int, cpu_s: float,
) -> Row:  # fmt: skip
    return {
        "in_effect": in_effect,
        "megabytes_per_s": count / elapsed_s / 1e6,
        "exposures_hz": exposures / elapsed_s,
        "lost": lost,
        "waits_percent": None if gaps_ms is None else sum(gaps_ms) / 10 / elapsed_s,
        "driver_cpu_percent": 100 * cpu_s / elapsed_s,
        "gaps": gaps_ms,
    }


def summary(reads: int, rounds: Sequence[Row]) -> Row:
    """Return the line of a number of reads: the median round, the range of throughput, all gaps."""
    rates = [row["megabytes_per_s"] for row in rounds]
    known = rounds[0]["gaps"] is not None
    gaps = spread([gap for row in rounds for gap in row["gaps"] or ()])

    def middle(name: str) -> float:
        return round(float(np.median([row[name] for row in rounds])), 2)

    return {
        "reads": reads, "in_effect": rounds[0]["in_effect"],
        "megabytes_per_s": middle("megabytes_per_s"),
        "range_megabytes_per_s": f"{min(rates):.1f} to {max(rates):.1f}",
        "exposures_hz": middle("exposures_hz"),
        "link_waits_percent": middle("waits_percent") if known else None,
        **{f"gap_{name}_ms": value if known else None for name, value in gaps.items()},
        "driver_cpu_percent": middle("driver_cpu_percent"),
        "lost": sum(row["lost"] for row in rounds),
    }  # fmt: skip


@contextmanager
def virtual_board(size_px: tuple[int, int]) -> Iterator[None]:
    """Attach a virtual board to this kernel; its link takes no time of its own."""
    board = RingBoard(RingSettings(ring=0, unlimited=True, size_px=size_px))
    failures: list[DriverError] = []
    port = free_port()

    def served() -> None:
        try:
            serve(board, port=port)
        except DriverError as error:
            failures.append(error)

    thread = threading.Thread(target=served, daemon=True)
    thread.start()
    deadline_s = time.monotonic() + FOUND_S
    while not failures and len(attached()) != 1:
        if time.monotonic() > deadline_s:
            raise DriverError(f"usbip: the kernel shows no board after {FOUND_S:g} s")
        time.sleep(0.05)
    if failures:
        raise failures[0]
    try:
        yield
    finally:
        detach(port)
        thread.join(FOUND_S)


@contextmanager
def computing(count: int) -> Iterator[None]:
    """Keep so many processes busy."""
    fresh = multiprocessing.get_context("spawn")
    others = [fresh.Process(target=_compute, daemon=True) for _ in range(count)]
    for other in others:
        other.start()
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.join()


def _compute() -> None:
    while True:
        sum(range(100_000))


if __name__ == "__main__":
    main()
