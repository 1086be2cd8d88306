"""How fast a GigE Vision camera is aimed: from the command to the frame that shows it.

Without `--camera`, Aravis' own fake camera on the loopback: then the figures are those of the host
(driver, library, UDP), to which a real camera adds its exposure and read-out.
"""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import DTypeLike, NDArray

from bench.machine import LIBRARIES, facts
from bench.options import JSON, Bench
from drivers.genicam import GenicamSensor, GenicamSensorSettings
from drivers.sensor import Exposure
from pipeline.errors import DriverError
from pipeline.messages import RoiSchedule

FAKE = "Aravis-Fake-F1"


@click.command(cls=Bench, help=__doc__)
@click.option("--camera", default="", help="Id, serial, user name or address.")
@click.option("--count", default=300, type=click.IntRange(10, 100_000), help="Exposures.")
@click.option("--binning", default=8, type=click.IntRange(2, 32))
@click.option("--seed", default=7, help="Of the windows that are commanded.")
@JSON
def main(camera: str, count: int, binning: int, seed: int, path: Path | None) -> None:
    """Measure and print."""
    if camera:
        figures = measured(camera, count, binning, seed)
    else:
        with fake_camera():
            figures = measured(FAKE, count, binning, seed)
    report = {
        "bench": "genicam",
        **facts((*LIBRARIES, "PyGObject")),
        "camera": camera or "Aravis' fake camera on the loopback",
        "seed": seed,
        "count": count,
        "summary": figures,
    }
    text = json.dumps(report, indent=1)
    click.echo(text)
    if path is not None:
        path.write_text(text + "\n")


def measured(camera: str, count: int, binning: int, seed: int) -> dict[str, Any]:
    """Command a window per exposure, each when the exposure before it is there."""
    sensor = GenicamSensor(GenicamSensorSettings(camera=camera, binning=binning))
    draw = np.random.default_rng(seed)
    sensor.open(realtime=False)
    try:
        grid, lead = sensor.capabilities().geometry, sensor.capabilities().lead_frames
        sensor.start()
        seen = exposed(sensor)
        waited_ms, between_ms, obeyed = list[float](), list[float](), 0
        began_s = time.monotonic()
        for _ in range(count):
            x = int(draw.integers(0, grid.width_px - grid.roi_width_px))
            y = int(draw.integers(0, grid.height_px - grid.roi_height_px))
            window = (grid.aligned(x), grid.aligned(y), x + 1, y + 1)
            sent_s, header = time.monotonic(), seen.header
            windows = np.array([window] * lead, np.int32)
            sensor.set_rois(RoiSchedule(header=header, first_seq=header.seq + 1, windows=windows))
            for _ in range(lead):
                seen = exposed(sensor)
            waited_ms.append((time.monotonic() - sent_s) * 1e3)
            between_ms.append(seen.roi.delay_ns / 1e6)
            obeyed += seen.roi.status == "ok" and seen.roi.command_seq == header.seq
        lasted_s = time.monotonic() - began_s
        told = sensor.summary()
    finally:
        sensor.close()
    return {
        "latency_frames": told["latency_frames"],
        "roi_px": f"{grid.roi_width_px}x{grid.roi_height_px}",
        "exposures_hz": round(count * lead / lasted_s, 1),
        "obeyed": obeyed,
        "command_to_roi_ms": spread(waited_ms),
        "context_to_roi_ms": spread(between_ms),
        "incomplete": told["frames"]["incomplete"],
    }


def exposed(sensor: GenicamSensor) -> Exposure:
    """The next exposure."""
    found = sensor.read(fresh)
    if found is None:
        raise DriverError("genicam: expected an exposure, got the end")
    return found


def fresh(
    _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
) -> NDArray[Any]:
    """Memory for one frame."""
    return np.empty(shape, dtype)


def spread(values: list[float]) -> dict[str, float]:
    """Median, 95th percentile and the largest."""
    return {
        "p50": round(statistics.median(values), 2),
        "p95": round(float(np.percentile(values, 95)), 2),
        "most": round(max(values), 2),
    }


@contextmanager
def fake_camera() -> Iterator[None]:
    """Aravis' fake camera in a process of its own."""
    command = [sys.executable, "-m", "drivers.genicam.fake_camera"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            if process.stdout is None or process.stdout.readline() != "ready\n":
                raise DriverError("genicam: expected the fake camera ready, got its end")
            yield
        finally:
            process.kill()


if __name__ == "__main__":
    main()
