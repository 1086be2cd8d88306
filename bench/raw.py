"""Time from raw frames to RGB, beside other ways and beside one pass over the memory.

`python -m bench.raw [--json FILE]`. A context is shrunk to 480 pixels width, an ROI keeps its size.
All ways run in one process on one thread in shuffled order, several rounds; processor time is
counted, so that what else runs disturbs little. `numba` is measured where it is installed; nothing
of fovea needs it.
"""

import json
import time
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from bench.machine import LIBRARIES, facts
from bench.options import JSON, Bench
from drivers.mosaic import write_samples
from operators.downsample import Downsample, DownsampleSettings, fitted
from pipeline import Frame
from pipeline.pixel_formats import FORMATS, PixelFormat
from pipeline.testing import header

SIZES_PX = ((2040, 1148), (4080, 2296))  # the paper's context and ROI
NAMES = ("bayer_rggb8", "bayer_rggb10p", "bayer_rggb12p", "bayer_rggb16")
WIDTH_PX = 480
LEVELS = {"black_level": 16, "gains": (1.9, 1.0, 1.6)}  # what a real sensor needs
Way = Callable[[], NDArray[Any] | None]
Row = dict[str, Any]


def scene(form: PixelFormat, size_px: tuple[int, int], seed: int) -> NDArray[Any]:
    """Pixels of a mosaic of a smooth picture with noise."""
    rng, (width, height) = np.random.default_rng(seed), size_px
    coarse = rng.uniform(0.1, 0.9, (18, 32)).astype(np.float32)
    light = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))
    noisy = light + 0.02 * rng.standard_normal(light.shape, np.float32)
    samples = np.rint(noisy.clip(0, 1) * form.white).astype(np.uint16)
    pixels = np.empty(form.shape(size_px), form.dtype)
    write_samples(samples, form, pixels)
    return pixels


def plain_samples(pixels: NDArray[Any], form: PixelFormat) -> NDArray[Any]:
    """Samples (h, w) in the way that the format's definition is usually written down in numpy."""
    if not form.packed:
        return pixels
    parts = [pixels[:, k :: form.bits // 2].astype(np.uint16) for k in range(form.bits // 2)]
    if form.bits == 10:
        b0, b1, b2, b3, b4 = parts
        found = [b0 | (b1 & 3) << 8, b1 >> 2 | (b2 & 15) << 6,
                 b2 >> 4 | (b3 & 63) << 4, b3 >> 6 | b4 << 2]  # fmt: skip
    else:
        b0, b1, b2, b3, b4, b5 = parts
        found = [b0 | (b1 & 15) << 8, b1 >> 4 | b2 << 4, b3 | (b4 & 15) << 8, b4 >> 4 | b5 << 4]
    return np.stack(found, -1).reshape(len(pixels), -1)


def floor(pixels: NDArray[Any]) -> Way:
    """Read every byte once."""
    words = pixels.reshape(-1).view(np.uint64)

    def way() -> None:
        np.bitwise_or.reduce(words)

    return way


def by_opencv(pixels: NDArray[Any], form: PixelFormat, out: NDArray[np.uint8]) -> Way:
    """Unpack, cut to 8 bit, demosaic all of it, shrink: the obvious way."""

    def way() -> NDArray[Any]:
        samples = plain_samples(pixels, form)
        light = samples if form.bits == 8 else (samples >> form.bits - 8).astype(np.uint8)
        whole = cv2.cvtColor(light, cv2.COLOR_BayerRGGB2RGB)
        if whole.shape == out.shape:
            return np.asarray(whole)
        size = out.shape[1::-1]
        return np.asarray(cv2.resize(whole, size, dst=out, interpolation=cv2.INTER_AREA))

    return way


def by_numpy(pixels: NDArray[Any], form: PixelFormat, out: NDArray[np.uint8]) -> Way:
    """Sum the superpixels of whole rows and columns between the edges of cells."""

    def way() -> NDArray[Any]:
        samples = plain_samples(pixels, form)
        height, width = samples.shape
        rows = np.arange(out.shape[0]) * (height // 2) // out.shape[0]
        columns = np.arange(out.shape[1]) * (width // 2) // out.shape[1]
        count = np.outer(np.diff(rows, append=height // 2), np.diff(columns, append=width // 2))

        def mean(y: int, x: int) -> NDArray[Any]:
            sums = np.add.reduceat(samples[y::2, x::2], rows, axis=0, dtype=np.uint32)
            return np.asarray(np.add.reduceat(sums, columns, axis=1) * (255 / form.white) / count)

        colours = mean(0, 0), (mean(0, 1) + mean(1, 0)) / 2, mean(1, 1)
        return np.asarray(np.rint(np.stack(colours, -1)), np.uint8)

    return way


def by_numba(pixels: NDArray[Any], form: PixelFormat, out: NDArray[np.uint8]) -> Way:
    """One fused loop over the packed bytes, compiled."""
    kernel = _kernel(form.bits if form.packed else 0)
    scale, size = 255 / form.white, form.size_px(pixels.shape)

    def way() -> NDArray[Any]:
        kernel(pixels, out, size[0] // 2, size[1] // 2, scale)
        return out

    return way


def by_fovea(
    pixels: NDArray[Any], form: PixelFormat, out: NDArray[np.uint8], **settings: Any
) -> Way:
    """The operator."""
    width_px = out.shape[1] if out.shape[1] < form.size_px(pixels.shape)[0] else 0
    subject = Downsample(
        DownsampleSettings(width_px=width_px, **settings), loan=lambda *_, **__: out
    )
    subject.open()
    frame = Frame(header=header(), pixels=pixels, pixel_format=form.name, window=(0, 0, 8, 8))
    return lambda: subject.on_frame(frame).pixels


def _kernel(bits: int) -> Any:
    """The compiled loop for packed samples of that many bits; 0: they are not packed."""
    numba = import_module("numba")

    @numba.njit(inline="always")  # type: ignore[untyped-decorator]
    def sample(row: Any, x: int) -> Any:
        if bits == 0:
            return np.float32(row[x])
        first = x * bits
        pair = np.uint32(row[first >> 3]) | np.uint32(row[(first >> 3) + 1]) << np.uint32(8)
        return np.float32(pair >> np.uint32(first & 7) & np.uint32((1 << bits) - 1))

    @numba.njit(fastmath=True)  # type: ignore[untyped-decorator]
    def bin_cells(pixels: Any, out: Any, width: int, height: int, scale: float) -> None:
        high, wide = out.shape[0], out.shape[1]
        line = np.zeros(4 * (wide + 1), np.float32)
        total = np.zeros(4 * (wide + 1), np.float32)
        share = np.float32(scale * wide * high / (width * height))
        for y in range(height):
            low, up = y * high / height, (y + 1) * high / height
            cell = int(low + 1e-9)
            part = np.float32((min(up, cell + 1.0) - low) / (up - low))
            line[:] = 0
            even, odd = pixels[2 * y], pixels[2 * y + 1]
            for x in range(width):
                left, right = x * wide / width, (x + 1) * wide / width
                at = int(left + 1e-9)
                here = np.float32((min(right, at + 1.0) - left) / (right - left))
                for k in range(4):
                    value = sample(even if k < 2 else odd, 2 * x + k % 2)
                    line[4 * at + k] += here * value
                    line[4 * at + 4 + k] += (np.float32(1) - here) * value
            for k in range(4 * wide):
                total[k] += part * line[k]
            if up >= cell + 1 - 1e-9:
                for k in range(wide):
                    red, blue = total[4 * k], total[4 * k + 3]
                    green = (total[4 * k + 1] + total[4 * k + 2]) * np.float32(0.5)
                    out[cell, k, 0] = np.uint8(red * share + np.float32(0.5))
                    out[cell, k, 1] = np.uint8(green * share + np.float32(0.5))
                    out[cell, k, 2] = np.uint8(blue * share + np.float32(0.5))
                for k in range(4 * wide):
                    total[k] = (np.float32(1) - part) * line[k]

    return bin_cells


def ways(form: PixelFormat, pixels: NDArray[Any], path: str) -> dict[str, Way]:
    """Everything that is compared on one frame."""
    size_px = form.size_px(pixels.shape)
    height, width = fitted(size_px[::-1], WIDTH_PX if path == "context" else 0)

    def memory() -> NDArray[np.uint8]:
        return np.empty((height, width, 3), np.uint8)

    found = {"floor": floor(pixels), "fovea": by_fovea(pixels, form, memory())}
    found["opencv"] = by_opencv(pixels, form, memory())
    found["fovea, levels"] = by_fovea(pixels, form, memory(), **LEVELS)
    found["fovea, gamma"] = by_fovea(pixels, form, memory(), **LEVELS, gamma=2.2)
    if path == "context":
        found["numpy"] = by_numpy(pixels, form, memory())
        if find_spec("numba"):
            found["numba"] = by_numba(pixels, form, memory())
    return found


def compare(found: Mapping[str, Way], rounds: int, rng: np.random.Generator) -> list[Row]:
    """Time all ways alternately; ratios are of medians, differences from fovea's picture."""
    pictures = {name: way() for name, way in found.items()}  # warm: memory, compiled code
    wanted = np.array(pictures["fovea"], np.int16)
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in found}
    for _ in range(rounds):
        for name in rng.permutation(list(found)):
            wall, own = time.perf_counter_ns(), time.thread_time_ns()
            found[name]()
            own, wall = time.thread_time_ns() - own, time.perf_counter_ns() - wall
            spent[name].append((own / 1e6, wall / 1e6))
    floor_ms = float(np.median([own for own, _ in spent["floor"]]))
    rows = []
    for name, times in spent.items():
        own, wall = np.array(times).T
        picture = pictures[name]
        same = picture is not None and "," not in name
        off = np.abs(np.asarray(picture, np.int16) - wanted).mean() if same else None
        rows.append({
            "way": name, "cpu_ms_p50": round(float(np.median(own)), 2),
            "cpu_ms_min": round(float(own.min()), 2), "cpu_ms_max": round(float(own.max()), 2),
            "wall_ms_p50": round(float(np.median(wall)), 2),
            "passes": round(float(np.median(own)) / floor_ms, 1),
            "mean_difference": None if off is None else round(float(off), 2),
        })  # fmt: skip
    return rows


@click.command(cls=Bench)
@click.option("--rounds", default=15, type=click.IntRange(3), help="How often each way runs.")
@click.option("--seed", default=1, type=click.IntRange(0))
@JSON
def main(*, rounds: int, seed: int, path: Path | None) -> None:
    """Time raw to RGB: context (480 wide) and ROI (full size), four formats, two sizes."""
    cv2.setNumThreads(1)
    rng, rows = np.random.default_rng(seed), list[Row]()
    for size_px in SIZES_PX:
        for name in NAMES:
            form = FORMATS[name]
            pixels = scene(form, size_px, seed)
            for part in ("context", "roi"):
                found = compare(ways(form, pixels, part), rounds, rng)
                size = f"{size_px[0]}x{size_px[1]}"
                rows += [{"size": size, "format": name, "path": part} | row for row in found]
                for row in rows[-len(found) :]:
                    click.echo("  ".join(f"{value!s:>13}" for value in row.values()))
    report = facts((*LIBRARIES, "numba")) | {
        "bench": "raw", "seed": seed, "rounds": rounds, "width_px": WIDTH_PX, "rows": rows,
    }  # fmt: skip
    if path:
        path.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
