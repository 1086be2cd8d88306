"""Compare versions of the detector: `python -m bench.detector_versions NAME=FILE NAME=FILE …`.

Scores each on the stills that no training saw (FOOTBALL, broadcast, and WIDE, a whole pitch), by
match and at several scales, with confidences chosen on the development stills at the same scale,
and on SEQUENCE, a SoccerNet folder, with the network's own. A ball is also judged by its centre and
by whether it is among the best three candidates; on the sequence apart for a ball that lies still,
is free or is carried. FILE@WIDTHxHEIGHT gives a network an input other than its usual one, into
which smaller pictures are enlarged.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from bench.ball_candidates import candidates
from bench.detector import scored
from bench.detector_scoring import BEST
from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

SCALES = {"football": (0.25, 0.5, 1.0), "wide": (0.7, 1.0)}
IN_BEST = f"among {BEST}"
Row = dict[str, Any]


def named(text: str) -> tuple[str, str, tuple[int, int]]:
    """Return name, file and input (0, 0: its usual one) of a version; raises `SettingsError`.

    >>> named("before=old.onnx"), named("enlarged=eight_bits@736x416")
    (('before', 'old.onnx', (0, 0)), ('enlarged', 'eight_bits', (736, 416)))
    """
    found = re.fullmatch(r"([^=]+)=(.+?)(?:@(\d{1,5})x(\d{1,5}))?", text)
    if not found:
        raise SettingsError(f"versions: expected NAME=FILE.onnx[@WIDTHxHEIGHT], got {text[:60]!r}")
    return found[1], found[2], (int(found[3] or 0), int(found[4] or 0))


def rows_of(version: str, report: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each class of all pictures, and of each match where there are several."""
    parts: dict[str, Sequence[Mapping[str, Any]]] = {"all": report["classes"]}
    if len(matches := report.get("matches", {})) > 1:
        parts |= matches
    for match, classes in parts.items():
        for found in classes:
            yield {
                "version": version, "data": report["data"], "scale": report["scale"],
                "match": match, "class": found["class"], "present": found["present"],
                "precision": found["precision"], "recall": found["recall"],
                "average precision": found["average_precision"],
                IN_BEST: found.get(f"among_{BEST}"),
            }  # fmt: skip


def rows_of_states(version: str, report: Mapping[str, Any]) -> Iterator[Row]:
    """Yield how often a ball in each state was among the best candidates."""
    for state, found in report["among"].items():
        yield {
            "version": version, "data": report["data"], "scale": report["scale"], "match": "all",
            "class": f"ball, {state}", "present": found["frames"], "precision": None,
            "recall": None, "average precision": None, IN_BEST: found["share"],
        }  # fmt: skip


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True)
@click.option("--football", type=click.Path(path_type=Path, exists=True), help="Labelled stills.")
@click.option("--wide", type=click.Path(path_type=Path, exists=True), help="Of a whole pitch.")
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet's.")
@click.option(
    "--scale", "scales", multiple=True, type=click.FloatRange(0.01, 1),
    help="Of the stills, several times; usually .25, .5 and 1, of a whole pitch .7 and 1.",
)  # fmt: skip
@JSON
def main(
    versions: tuple[str, ...], football: Path | None, wide: Path | None, sequence: Path | None,
    scales: tuple[float, ...], path: Path | None,
) -> None:  # fmt: skip
    """Compare versions of the detector, by match and scale."""
    folders = {name: folder for name, folder in (("football", football), ("wide", wide)) if folder}
    if not folders and sequence is None:
        raise SettingsError("data: expected --football, --wide or --sequence, got none of them")
    rows: list[Row] = []
    times: list[Row] = []
    for version, file, input_px in map(named, versions):
        for data, folder in folders.items():
            for scale in scales or SCALES[data]:
                report = scored(
                    folder, file, scale=scale, split="test", choose_on="development",
                    input_px=input_px,
                )  # fmt: skip
                rows += rows_of(version, report)
                told = {"version": version, "data": data, "scale": scale}
                times.append(
                    told
                    | {"input": "x".join(map(str, report["input_px"]))}
                    | {f"processor ms, {k}": v for k, v in report["processor_ms"].items()}
                )
        if sequence:
            report = candidates(sequence, file, scale=0.25, input_px=input_px)
            rows += [*rows_of(version, report), *rows_of_states(version, report)]
    console = Console()
    console.print(table("versions of the detector", rows))
    if times:
        console.print(table("time of a picture, one thread", times))
    if path:
        report = facts() | {
            "bench": "detector_versions", "versions": [named(v)[0] for v in versions],
            "rows": rows, "times": times,
        }  # fmt: skip
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
