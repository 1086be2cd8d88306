"""Compare policies that read: `python -m bench.text_policies --data FOLDER [--policy FILE]`.

Each policy looks at the same recorded clips of streets, whose pictures, detections and tracks do
not depend on where it looks; missing clips are recorded. What a window shows is read by a simulated
reader (operators/policy/reading/street.py), and what was read returns to the policy, so that a clip
takes a second. Prints the share of the legible texts that were shown at a readable size, and that
were read, and the frames from the first one in which a text is legible to its reading (below 0: it
was read before). The oracle knows the truth: it shows the window that reads most in the next frame.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from bench.machine import facts
from bench.options import JSON, Bench, told_changes
from bench.prototype import table
from bench.tracking.intervals import Block, difference, mean
from operators.policy import (
    CentredPolicy,
    CentredPolicySettings,
    GreedyReadingPolicy,
    GreedyReadingPolicySettings,
    ReadingPolicy,
    ReadingPolicySettings,
    RoundRobinPolicy,
    RoundRobinPolicySettings,
)
from operators.policy.data import Recording, record
from operators.policy.gaze_plan import GazePlan, scanpath, stay
from operators.policy.inputs import PolicyInputs
from operators.policy.reading.settings import GRAPH
from operators.policy.reading.street import SimulatedReader, Street
from operators.policy.reading.windows import around
from operators.policy.rollout import within
from operators.policy.utility import windows
from pipeline import Frame, Percept, Scanpath, Tracks
from pipeline.boxes import from_centres, roi_window

Box = NDArray[np.float32]
BESIDE = "greedy"  # the rows' differences are to this one


@dataclass(frozen=True, kw_only=True)
class OracleSettings:
    """None."""


class Oracle(PolicyInputs[OracleSettings]):
    """Show the window that reads most of what was not read; it knows street and reader."""

    def __init__(self, street: Street, reader: SimulatedReader) -> None:
        super().__init__(OracleSettings())
        self._street, self._reader = street, reader

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the next frame only."""
        frame = tracks.header.seq - self._street.recording.header(0).seq + 1
        boxes, geometry = self._street.boxes[frame], tracks.header.geometry
        gain = self._street.chance[frame] * ~self._reader.read
        if not gain.any():
            return scanpath(tracks, GazePlan(choice=np.zeros(0, np.int32), boxes=boxes[:0]))
        rows = np.flatnonzero(gain)
        places, shows = around(boxes[rows], gain[rows], geometry)
        best = places[int((shows @ gain[rows]).argmax())]
        size = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
        return scanpath(tracks, stay(from_centres(best, size), 1))


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When plans take effect, in frames."""

    delay: int
    replan: int


@click.command(cls=Bench)
@click.option("--data", type=click.Path(path_type=Path), required=True, help="recorded clips")
@click.option("--policy", "weights", type=click.Path(path_type=Path))
@click.option("--first-seed", default=50_000, show_default=True, help="of the clips")
@click.option("--clips", default=20, show_default=True, type=click.IntRange(1))
@click.option("--frames", default=90, show_default=True, type=click.IntRange(2))
@click.option("--delay", default=0, show_default=True, type=click.IntRange(0))
@click.option("--replan", default=1, show_default=True, type=click.IntRange(1))
@click.option("--roi-scale", default=1.0, show_default=True, type=click.FloatRange(0.05, 1))
@click.option("--seed", default=1, show_default=True, help="of the reader's luck")
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE", help="of recording")
@JSON
def main(
    data: Path, weights: Path | None, first_seed: int, clips: int, frames: int, delay: int,
    replan: int, roi_scale: float, seed: int, changes: tuple[str, ...], path: Path | None,
) -> None:  # fmt: skip
    """Compare policies that read on recorded clips."""
    seeds = range(first_seed, first_seed + clips)
    paths = record(seeds, frames, data, workers=1, changes=changes, graph=GRAPH)
    streets = [Street(Recording(each), roi_scale) for each in paths]
    timing = Timing(delay=delay, replan=replan)
    found = {
        name: [watched(street, make, timing, seed) for street in streets]
        for name, make in policies(weights, delay).items()
    }
    rows = [row(name, streets, readers, found[BESIDE]) for name, readers in found.items()]
    timed = f"delay {delay}, Ta {replan}, ROI of {roi_scale:g} of the side"
    title = f"{clips} clips of {frames} frames, seeds {first_seed} and up, {timed}"
    Console().print(table(title, rows))
    if path:
        result = {
            "bench": "text_policies", **facts(), "first_seed": first_seed, "clips": clips,
            "frames": frames, "delay_frames": delay, "replan_frames": replan, "seed": seed,
            "roi_scale": roi_scale,
            "policy": weights.name if weights else "reading.onnx", "changes": told_changes(changes),
            "rows": rows,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


Make = Callable[[Street, SimulatedReader], PolicyInputs[Any]]


def policies(weights: Path | None, delay: int) -> Mapping[str, Make]:
    """Return what makes each policy for one clip."""
    file = str(weights or "")
    return {
        "learned": lambda *_: ReadingPolicy(ReadingPolicySettings(weights=file, delay=delay)),
        BESIDE: lambda *_: GreedyReadingPolicy(GreedyReadingPolicySettings(delay=delay)),
        "round robin": lambda *_: RoundRobinPolicy(RoundRobinPolicySettings()),
        "centred": lambda *_: CentredPolicy(CentredPolicySettings()),
        "oracle": Oracle,
    }


def watched(street: Street, make: Make, timing: Timing, seed: int) -> SimulatedReader:
    """Run a policy through a clip; return what was read."""
    reader, field = SimulatedReader(street, seed), street.geometry
    policy = make(street, reader)
    policy.open()
    middle = np.array([field.width_px / 2, field.height_px / 2], np.float32)
    window: Box = np.array(roi_window(middle, field), np.float32)
    commanded: dict[int, Box] = {}
    planned = -timing.replan
    for frame in range(len(street) - 1):
        moment, window = street.moment(frame), commanded.pop(frame, window)
        path = policy.on_tracks(moment.tracks)
        if len(path.boxes) and frame - planned >= timing.replan:
            planned = frame
            for step, box in enumerate(windows(path.boxes, field)[timing.delay :], timing.delay):
                commanded[frame + 1 + step] = box
        told(policy, moment.tracks, window, reader.look(window, frame))
        sides = roi_sides(window)
        policy.on_features(within(moment.seen, moment.tracks, sides))
    policy.close()
    return reader


def told(policy: PolicyInputs[Any], tracks: Tracks, window: Box, percept: Percept) -> None:
    """Report what was exposed and read."""
    pixels = np.zeros((1, 1, 3), np.uint8)
    policy.on_roi(Frame(header=tracks.header, pixels=pixels, window=roi_sides(window)))
    policy.on_percept(percept)


def roi_sides(window: Box) -> tuple[int, int, int, int]:
    """Return a window as a frame has it."""
    left, top, right, bottom = (int(side) for side in window)
    return left, top, right, bottom


def row(
    name: str,
    streets: list[Street],
    readers: list[SimulatedReader],
    beside: list[SimulatedReader],
) -> dict[str, object]:
    """Return the figures of one policy; intervals are over clips, differences paired by clip."""
    shown, read = (blocks(streets, readers, what) for what in ("shown_at", "read_at"))
    gain, low, high = difference(read, blocks(streets, beside, "read_at"))
    share, seen = mean(read), mean(shown)
    waits: list[int] = [
        int(wait)
        for street, reader in zip(streets, readers, strict=True)
        for wait in reader.read_at[reader.read] - street.legible[:, reader.read].argmax(0)
    ]
    return {
        "policy": name,
        "texts": share.frames,
        "shown": f"{seen.iou:.3f}",
        "read": f"{share.iou:.3f} ({share.low:.3f} .. {share.high:.3f})",
        f"read, above {BESIDE}": f"{gain:+.3f} ({low:+.3f} .. {high:+.3f})",
        "frames to reading": f"{np.median(waits):.0f}" if waits else "never",
    }


def blocks(streets: list[Street], readers: list[SimulatedReader], what: str) -> dict[str, Block]:
    """Return by clip how many of its texts have a frame in the column `what` of the reader."""
    return {
        street.recording.path.stem: Block(
            total=float((getattr(reader, what)[street.counts] >= 0).sum()),
            frames=int(street.counts.sum()),
            starts=1,
        )
        for street, reader in zip(streets, readers, strict=True)
    }


if __name__ == "__main__":
    main()
