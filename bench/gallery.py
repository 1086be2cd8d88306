"""Photograph the Rerun view of a graph in a browser: `python -m bench.gallery [GRAPH …]`.

Each graph runs as processes, with a recording; Rerun's web viewer shows the recording's end in a
headless Chromium, whose picture is written with a palette to stay small. The rates are
lower than the graphs' own, for a machine of two cores, and `whole_pitch` follows a player instead
of its ball. Latencies in a picture are those of one run on whatever else the machine did: no
measurement.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from urllib.parse import quote

import click
from PIL import Image

from bench.headless import Page, has_content
from bench.options import Bench
from operators.visualise.server import await_listener, free_ports, serve
from pipeline.errors import RunError

RESULTS = Path(__file__).resolve().parent / "results"
RUNS: dict[str, tuple[int, tuple[str, ...]]] = {  # frames, settings
    "tracking": (75, ("capture.options.rate_hz=10",)),
    # with the ball, the policy was searching
    "whole_pitch": (64, ("capture.options.rate_hz=4", "policy.target=player")),
    "text": (60, ("capture.options.rate_hz=3",)),
    "manipulation": (250, ()),  # until both objects are in the air
}
OTHERS: tuple[int, tuple[str, ...]] = (100, ("capture.options.rate_hz=10",))
SIZE_PX = (1600, 900)
SHOWN_PX = (1280, 720)
COLOURS = 256
LIMIT_S = 240.0


@click.command(cls=Bench)
@click.argument("graphs", nargs=-1)
@click.option("--out", default=RESULTS, type=click.Path(path_type=Path), help="A folder.")
@click.option(
    "--limit-s", default=LIMIT_S, type=click.FloatRange(1), show_default=True,
    help="Of a run, and of its drawing: more on a busy machine.",
)  # fmt: skip
def main(graphs: tuple[str, ...], out: Path, limit_s: float) -> None:
    """Write a picture of the view of each graph; without any, of the shipped ones named above."""
    for graph in graphs or RUNS:
        name = Path(graph).stem
        path = out / f"gallery_{name}.png"
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "seen.rrd"
            frames, changes = RUNS.get(name, OTHERS)
            record(graph, recording, frames, changes, limit_s)
            png = small(photograph(recording, limit_s))
        out.mkdir(parents=True, exist_ok=True)
        path.write_bytes(png)
        click.echo(f"{path.name}: {len(png) / 1000:.0f} kB, {frames} frames")


def record(
    graph: str, path: Path, frames: int, changes: tuple[str, ...], limit_s: float = LIMIT_S
) -> None:
    """Run a graph with a recording; raises `RunError` when it fails."""
    words = ["run", graph, "--frames", str(frames), "--save", str(path)]
    words += [f"--set={change}" for change in changes]
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.entry", *words],
        capture_output=True, text=True, timeout=limit_s, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RunError(f"{graph}: {done.stderr.strip()[-500:]}")


def photograph(
    recording: Path, timeout_s: float = LIMIT_S, there: Callable[[bytes], bool] = has_content
) -> bytes:
    """Return a PNG of the end of a recording in Rerun's web viewer, once `there` is true of it."""
    port, web_port = free_ports(2)
    server = serve(port, web_port, recording)
    try:
        data = f"rerun+http://127.0.0.1:{port}/proxy"
        await_listener(data)
        address = f"http://127.0.0.1:{web_port}/?url={quote(data, safe='')}"
        with Page(address, SIZE_PX) as page:
            return page.drawn(timeout_s, there)
    finally:
        server.terminate()
        server.wait()


def small(png: bytes) -> bytes:
    """Return the picture smaller and with few colours."""
    picture = Image.open(BytesIO(png)).convert("RGB").resize(SHOWN_PX, Image.Resampling.LANCZOS)
    out = BytesIO()
    picture.quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(out, "PNG", optimize=True)
    return out.getvalue()


if __name__ == "__main__":
    main()
