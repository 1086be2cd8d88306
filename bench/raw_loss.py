"""What the shipped detector loses on the noise of a raw sensor, against clean RGB.

`python -m bench.raw_loss [--weights FILE] [--json FILE]`. The same held-out procedural pictures are
seen clean, and through a sensor of 12 bit that counts light: `binned` reads all 1920x1080 pixels of
its mosaic, which Downsample averages to 480x270; `mosaic` reads a mosaic of 480x270, which is
demosaiced. Scenes are split into groups of their own seeds; the spread is that of the groups.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from bench.machine import facts
from bench.options import JSON, Bench, file_name
from drivers.noise import Response
from drivers.scenes.soccer import SoccerScene
from drivers.simulated.readout import Readout
from drivers.source import Annotations, FrameSource
from operators.downsample import Downsample, DownsampleSettings
from operators.saliency.evaluate import SEEDS, SPAN, collect
from operators.saliency.example import CONTEXT_PX, NAMES, Example
from operators.saliency.judging import Tally, at_threshold
from operators.saliency.render import FULL_PX, RATE_HZ, example, moments
from operators.saliency.saliency import SaliencySettings
from pipeline import Frame
from pipeline.pixel_formats import FORMATS
from pipeline.testing import header

FORM = FORMATS["bayer_rggb12p"]
BLACK, GAMMA = 240, 2.2
NOISES = {  # electrons at white and of the read-out
    "none": (0.0, 0.0), "bright": (10_000.0, 3.0), "dim": (2_000.0, 4.0), "dark": (500.0, 5.0),
}  # fmt: skip
READS = {"binned": FULL_PX, "mosaic": CONTEXT_PX}
CLEAN = "clean"
Figures = dict[str, dict[str, float]]  # class -> precision, recall


class Held:
    """A source that draws the same picture once."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self.size_px, self.rate_hz, self.length = source.size_px, source.rate_hz, source.length
        self._held: tuple[int, NDArray[np.uint8]] | None = None

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Frame `index`, drawn unless it is the one before."""
        if self._held is None or self._held[0] != index:
            self._held = index, self._source.picture(index)
        return self._held[1]

    def truth(self, index: int) -> Annotations | None:
        """As the source tells it."""
        return self._source.truth(index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()


@dataclass(frozen=True, kw_only=True)
class Eye:
    """One sensor and the operator behind it."""

    readout: Readout
    size_px: tuple[int, int]
    develop: Downsample

    def see(self, picture: NDArray[np.uint8], seq: int) -> NDArray[np.uint8]:
        """A full-size picture as the detector gets it: (270, 480, 3)."""
        pixels = np.empty(self.readout.shape(self.size_px), self.readout.dtype)
        window = (0, 0, *FULL_PX)
        self.readout.read(picture, window, pixels, seq=seq, port=0)
        raw = Frame(header=header(seq), pixels=pixels, pixel_format=FORM.name, window=window)
        return np.array(self.develop.on_frame(raw).pixels, np.uint8)


def eyes(seed: int) -> dict[str, Eye]:
    """A sensor for each way of reading and each noise."""
    settings = DownsampleSettings(width_px=CONTEXT_PX[0], black_level=BLACK, gamma=GAMMA)
    found = {}
    for read, size_px in READS.items():
        for noise, (full_well_e, read_noise_e) in NOISES.items():
            response = Response(
                bits=FORM.bits, black_level=BLACK, gamma=GAMMA, full_well_e=full_well_e,
                read_noise_e=read_noise_e,
            )  # fmt: skip
            most_px = size_px[0] * size_px[1]
            readout = Readout(form=FORM, response=response, seed=seed, most_px=most_px)
            develop = Downsample(settings)
            develop.open()
            found[f"{read}, {noise}"] = Eye(readout=readout, size_px=size_px, develop=develop)
    return found


def group(seeds: range, count: int, seed: int, weights: str) -> dict[str, Figures]:
    """Precision and recall in each condition over `count` pictures of every scene."""
    seen: dict[str, list[Example]] = {CLEAN: []}
    through = eyes(seed)
    for number, (scene, index) in enumerate(pictures(seeds, count)):
        item = example(scene, index)
        seen[CLEAN].append(item)
        for name, eye in through.items():
            shown = replace(item, picture=eye.see(scene.picture(index), number))
            seen.setdefault(name, []).append(shown)
    settings = SaliencySettings(weights=weights)
    return {name: figures(collect(items, settings)) for name, items in seen.items()}


def pictures(seeds: range, count: int) -> Iterator[tuple[Held, int]]:
    """Well-spaced moments of each scene."""
    for seed in seeds:
        scene = Held(SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed))
        yield from ((scene, index) for index in moments(seed, count, SPAN))
        scene.close()


def figures(tallies: Mapping[str, Tally]) -> Figures:
    """Precision and recall at the network's own thresholds, the macro being their mean."""
    found = {name: at_threshold(tallies[name], 0.0) for name in (*NAMES, "ball centre")}
    macro = {f: float(np.mean([found[n][f] for n in NAMES])) for f in ("precision", "recall")}
    return {**found, "macro": macro}


def rows(groups: list[dict[str, Figures]]) -> list[dict[str, Any]]:
    """Means over the groups, and what is lost against clean with its standard error, in points."""
    found = []
    for condition in groups[0]:
        for name in groups[0][condition]:
            row: dict[str, Any] = {"condition": condition, "class": name}
            for figure in ("precision", "recall"):
                values = np.array([g[condition][name][figure] for g in groups])
                lost = np.array([g[CLEAN][name][figure] for g in groups]) - values
                error = lost.std(ddof=1) / np.sqrt(len(lost))
                row[figure] = round(float(values.mean()), 3)
                row[f"{figure}_lost_points"] = round(float(100 * lost.mean()), 1)
                row[f"{figure}_standard_error"] = round(float(100 * error), 1)
            found.append(row)
    return found


@click.command(cls=Bench)
@click.option("--groups", "count", default=5, type=click.IntRange(2, 10), help="Of scenes.")
@click.option("--scenes", default=4, type=click.IntRange(1, 4), help="In each group.")
@click.option("--moments", "each", default=8, type=click.IntRange(1), help="Pictures of a scene.")
@click.option("--seed", default=1, type=click.IntRange(0), help="Of the noise.")
@click.option("--weights", default="", help="As saliency.weights; the shipped detector's if none.")
@JSON
def main(*, count: int, scenes: int, each: int, seed: int, weights: str, path: Path | None) -> None:
    """Measure what noise costs the detector, in points of precision and recall."""
    cv2.setNumThreads(1)
    groups = []
    for number in range(count):
        first = SEEDS["test"][number * scenes]
        groups.append(group(range(first, first + scenes), each, seed + number, weights))
        click.echo(f"group {number + 1} of {count}: scenes {first} to {first + scenes - 1}")
    table = rows(groups)
    for row in table:
        click.echo("  ".join(f"{value!s:>15}" for value in row.values()))
    report = facts() | {
        "bench": "raw_loss", "weights": file_name(SaliencySettings(weights=weights).detector.path),
        "seed": seed, "groups": count, "scenes_of_a_group": scenes,
        "pictures": count * scenes * each, "first_scene": SEEDS["test"][0],
        "electrons_at_white_and_read_noise": {n: f"{w:g}, {r:g}" for n, (w, r) in NOISES.items()},
        "rows": table,
    }  # fmt: skip
    if path:
        path.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
