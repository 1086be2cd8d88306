"""Draw one frame of a graph: `python -m bench.picture [GRAPH] [--source …] [--out FILE]`.

Runs the graph in line and draws its last frame: left the context with the tracks (white), the ROI
(yellow) and the tracker's answer (red); right the ROI's window as the context shows it, and as the
ROI does. The same graph with the same settings gives the same picture.
"""

from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from bench.options import Bench, on_graph
from pipeline.errors import RunError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message, Percept, Tracks
from pipeline.run.inline import InlineRunner

OUT = Path(__file__).resolve().parent / "results" / "picture.png"
HEIGHT_PX = 540  # of the picture; it is 8/3 as wide: 16:9 on the left, two halves on the right
WHITE, YELLOW, RED = (255, 255, 255), (255, 210, 0), (255, 60, 60)
Picture = NDArray[np.uint8]  # (h, w, 3) RGB


@click.command(cls=Bench)
@on_graph
@click.option("--frames", default=120, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--out", default=OUT, type=click.Path(path_type=Path), help="A PNG.")
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], frames: int, out: Path
) -> None:
    """Draw what a graph saw after so many frames."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="lockstep"))
    last: dict[str, Message] = {}

    def keep(output: str, message: Message) -> None:
        last[output] = message

    with InlineRunner(plan, watch=keep) as runner:
        for _ in runner.run(frames):
            pass
    out.parent.mkdir(parents=True, exist_ok=True)
    _, png = cv2.imencode(".png", cv2.cvtColor(draw(last), cv2.COLOR_RGB2BGR))
    out.write_bytes(png.tobytes())
    click.echo(f"{out.name}: frame {frames} of {plan.name}")


def draw(last: dict[str, Message]) -> Picture:
    """Return the panels of one frame; raises `RunError` where the graph has no such outputs."""
    context, roi = last.get("capture.context"), last.get("capture.roi")
    if not isinstance(context, Frame) or not isinstance(roi, Frame):
        raise RunError(f"expected frames of capture.context and capture.roi, got {sorted(last)}")
    if not roi.pixels.size or {context.pixel_format, roi.pixel_format} != {"rgb8"}:
        got = f"{context.pixel_format} and {roi.pixel_format} of {roi.pixels.shape}"
        raise RunError(f"expected an RGB context and an RGB ROI that is not empty, got {got}")
    scale = np.divide((HEIGHT_PX * 16 / 9, HEIGHT_PX), _size(context.window))
    left = _enlarged(context.pixels, (HEIGHT_PX * 16 // 9, HEIGHT_PX))
    tracks, percept = last.get("association.out"), last.get("tracker.out")
    for box in tracks.boxes[:, -1] if isinstance(tracks, Tracks) else ():
        _outline(left, box, scale, WHITE, 1)
    for box in percept.boxes if isinstance(percept, Percept) else ():
        _outline(left, box, scale, RED, 2)
    _outline(left, np.asarray(roi.window, np.float32), scale, YELLOW, 2)
    half = (HEIGHT_PX * 8 // 9, HEIGHT_PX // 2)
    right = [_enlarged(_cut(context, roi.window), half), _enlarged(roi.pixels, half)]
    height, width = context.pixels.shape[:2]
    share = roi.pixels.shape[0] * roi.pixels.shape[1] + height * width
    whole = np.prod(_size(context.window))
    titles = (
        f"context {width}x{height}; with the ROI {share / whole:.1%} of the pixels",
        "the ROI's window in the context",
        "ROI",
    )
    for panel, title in zip((left, *right), titles, strict=True):
        _write(panel, title)
    return np.hstack([left, np.vstack(right)])


def _cut(frame: Frame, window: tuple[int, int, int, int]) -> Picture:
    """Return the part of a frame's pixels that shows a window of the sensor."""
    height, width = frame.pixels.shape[:2]
    by = np.divide((width, height), _size(frame.window))
    x0, y0 = np.multiply(np.subtract(window[:2], frame.window[:2]), by).astype(int)
    x1, y1 = np.ceil(np.multiply(np.subtract(window[2:], frame.window[:2]), by)).astype(int)
    return np.asarray(frame.pixels[y0:y1, x0:x1], np.uint8)


def _size(window: tuple[int, int, int, int]) -> tuple[int, int]:
    return window[2] - window[0], window[3] - window[1]


def _enlarged(pixels: NDArray[np.uint8] | NDArray[np.uint16], size_px: tuple[int, int]) -> Picture:
    """Return the pixels at another size, not smoothed when enlarged."""
    finer = size_px[0] > pixels.shape[1]
    how = cv2.INTER_NEAREST if finer else cv2.INTER_AREA
    return np.asarray(cv2.resize(pixels, size_px, interpolation=how), np.uint8)


def _outline(
    picture: Picture, box: NDArray[np.float32], scale: NDArray[np.float64],
    colour: tuple[int, int, int], thickness_px: int,
) -> None:  # fmt: skip
    x0, y0, x1, y1 = (box * np.tile(scale, 2)).round().astype(int).tolist()
    cv2.rectangle(picture, (x0, y0), (x1, y1), colour, thickness_px, cv2.LINE_AA)


def _write(picture: Picture, text: str) -> None:
    for start, colour in (((9, 21), (0, 0, 0)), ((8, 20), WHITE)):  # a shadow, then the text
        cv2.putText(picture, text, start, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)


if __name__ == "__main__":
    main()
