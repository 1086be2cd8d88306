"""Measure the recorder: `python -m bench.recording [--seconds 6] [--kills 50] [--json FILE]`.

Two streams of the prototype's sizes, a context of 2040x1148 and an ROI of 4080x2296, are given to
the recorder at 30 Hz, as RGB and as mosaics of eight bits, with each compression: what reaches the
file, what is dropped, and the processor time. No graph runs: nothing here draws or reads that much.
Then recorders of two small streams are killed at random times, and their files are read.
"""

import json
import multiprocessing
import random
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from bench.loop import spread
from bench.machine import facts
from bench.options import JSON, Bench
from bench.results.markdown import table_of
from drivers.scenes import SoccerScene
from pipeline.messages import Frame
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Limits, Recorder
from pipeline.testing import header

SIZES_PX = {"capture.context": (2040, 1148), "capture.roi": (4080, 2296)}
SMALL_PX = {"capture.context": (480, 270), "capture.roi": (480, 270)}
RATE_HZ = 30.0
PICTURES = 6  # of each stream, shown in turn
NOISE = 2.0  # standard deviation in levels: a picture without any would shrink too well
FORMATS = {"rgb8": 3, "bayer_rggb8": 1}  # bytes a pixel
COMPRESSIONS = ("zstd", "lz4", "none")
START_S, ALIVE_S = 20.0, (0.3, 2.5)  # to begin a file; from then until the kill
NS = 1_000_000_000
Pixels = NDArray[np.uint8]
Row = dict[str, Any]


@click.command(cls=Bench, help=__doc__)
@click.option("--seconds", default=6.0, show_default=True, type=click.FloatRange(0.5, 60))
@click.option("--kills", default=50, show_default=True, type=click.IntRange(1))
@click.option("--seed", default=1, show_default=True, help="Of the pictures and times of kills.")
@JSON
def main(seconds: float, kills: int, seed: int, path: Path | None) -> None:
    """Record with each format and compression, then kill recorders."""
    rows: list[Row] = []
    for form in FORMATS:
        shown = pictures(SIZES_PX, form, seed)
        rows += [
            {"pixels": form, "compression": one, **recorded(shown, form, one, seconds)}
            for one in COMPRESSIONS
        ]
    killed = after_kills(kills, seed)
    click.echo(table_of(rows))
    click.echo(table_of([killed]))
    if path:
        result = {"bench": "recording", **facts(("mcap", "numpy")), "rate_hz": RATE_HZ,
                  "seconds": seconds, "seed": seed, "n": kills, "rows": rows,
                  "killed": killed}  # fmt: skip
        path.write_text(json.dumps(result, indent=1) + "\n")


def pictures(sizes_px: dict[str, tuple[int, int]], form: str, seed: int) -> dict[str, list[Pixels]]:
    """Return noisy pictures of a drawn scene, some for each stream."""
    rng = np.random.default_rng(seed)
    scene = SoccerScene(size_px=(1920, 1080), seed=seed)
    found: dict[str, list[Pixels]] = {name: [] for name in sizes_px}
    for frame in range(PICTURES):
        drawn = scene.picture(frame)
        for name, size_px in sizes_px.items():
            large = cv2.resize(drawn, size_px, interpolation=cv2.INTER_LINEAR)
            if FORMATS[form] == 1:
                large = mosaic(np.asarray(large, np.uint8))
            noise = rng.standard_normal(large.shape, np.float32) * NOISE
            found[name].append(np.clip(large + noise, 0, 255).astype(np.uint8))
    return found


def mosaic(pixels: Pixels) -> Pixels:
    """Return what a sensor behind a filter of red, green, green and blue reads of RGB pixels.

    >>> mosaic(np.arange(12, dtype=np.uint8).reshape(2, 2, 3)).tolist()
    [[0, 4], [7, 11]]
    """
    found = pixels[..., 1].copy()
    found[::2, ::2] = pixels[::2, ::2, 0]
    found[1::2, 1::2] = pixels[1::2, 1::2, 2]
    return found


def recorded(shown: dict[str, list[Pixels]], form: str, compression: str, seconds: float) -> Row:
    """Give pictures to a recorder at the rate of a sensor; return what became of them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seen.mcap"
        recorder = Recorder(path, Limits(compression=compression))
        own = psutil.Process()
        before, began_s = own.cpu_times(), time.monotonic()
        frames = give(recorder, shown, form, seconds)
        said = recorder.close()
        took_s, after = time.monotonic() - began_s, own.cpu_times()
        file_bytes = path.stat().st_size
    accounts = recorder.figures()
    pixel_bytes = sum(accounts[name]["recorded"] * shown[name][0].nbytes for name in shown)
    taken = sum(one["recorded"] for one in accounts.values()) / len(shown)
    cpu_s = after.user + after.system - before.user - before.system
    return {
        "exposures": frames, "recorded": taken,
        "dropped, share": round(1 - taken / frames, 3),
        "MB/s offered": round(RATE_HZ * sum(one[0].nbytes for one in shown.values()) / 1e6),
        "MB/s of pixels recorded": round(pixel_bytes / took_s / 1e6),
        "MB/s in the file": round(file_bytes / took_s / 1e6),
        "size": round(file_bytes / pixel_bytes, 3),
        "cpu ms an exposure": round(1000 * cpu_s / taken, 1),
        "failure": said or "none",
    }  # fmt: skip


def give(recorder: Recorder, shown: dict[str, list[Pixels]], form: str, seconds: float) -> int:
    """Queue exposures at their times, never waiting for room; return how many."""
    frames, began_s = int(seconds * RATE_HZ), time.monotonic()
    for seq in range(frames):
        time.sleep(max(0.0, began_s + seq / RATE_HZ - time.monotonic()))
        for name, some in shown.items():
            pixels = some[seq % len(some)]
            recorder.add(name, Frame(header=header(seq), pixels=pixels, pixel_format=form))
    return frames


def after_kills(kills: int, seed: int) -> Row:
    """Kill recorders at random times; return how their files end."""
    chance, late_s, unreadable = random.Random(seed), [], 0
    for _ in range(kills):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "seen.mcap"
            child = multiprocessing.get_context("spawn").Process(target=endless, args=(path,))
            child.start()
            await_chunk(path)
            time.sleep(chance.uniform(*ALIVE_S))
            child.kill()
            killed_ns = time.time_ns()
            child.join()
            try:
                last_ns = max(Recording(path).exposures.values())
            except Exception as error:  # what cannot be read is what is counted here
                click.echo(f"{path.name}: {error}", err=True)
                unreadable += 1
                continue
            late_s.append((killed_ns - last_ns) / NS)
    return {
        "kills": kills, "unreadable": unreadable,
        "s before the kill": spread(late_s) if late_s else None,
        "p90 s": round(statistics.quantiles(late_s, n=10)[-1], 2) if len(late_s) > 1 else None,
    }  # fmt: skip


def await_chunk(path: Path) -> None:
    """Wait until a recorder has written something; raises `TimeoutError` after `START_S`."""
    end_s = time.monotonic() + START_S
    while not (path.is_file() and path.stat().st_size > 1000):
        if time.monotonic() > end_s:
            raise TimeoutError(f"{path}: nothing was recorded within {START_S:.0f} s")
        time.sleep(0.01)


def endless(path: Path) -> None:
    """Record two small streams until killed."""
    recorder, shown = Recorder(path), pictures(SMALL_PX, "rgb8", 1)
    while True:
        give(recorder, shown, "rgb8", 60.0)


if __name__ == "__main__":
    main()
