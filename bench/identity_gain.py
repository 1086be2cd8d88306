"""What a look at somebody gains the identities: `python -m bench.identity_gain [--json FILE]`.

Under one ROI and many objects the consumer is `operators.identity`, and a look is worth what it
adds to knowing who is who. `GreedyPolicy` has a stand-in for that: the time since the last look, by
the doubt about who it is. Here the gain itself is measured. The tracks of drawn matches are those
of the graph's perception, and a sensor that could show everybody shows each person in a share of
the frames, drawn at random. The looks of each kind, by what identity knows of the track at that
moment, are left out once: the AssA that is lost is their gain.

Printed by kind, beside the stand-in of the same looks, and the rank correlation over kinds.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.stats import spearmanr

from bench.consumer_gain import half_interval
from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera
from bench.tracking.clip import PROCEDURAL, Clip, ClipName, read
from bench.tracking.identities import ROI_STAGES, Played, everybody
from bench.tracking.many import identity_of, scored
from bench.tracking.metrics import need_trackeval
from bench.tracking.replaced import Replaced
from bench.tracking.sight import PERCEPTION, watched
from bench.tracking.stages import Stages
from operators.identity import Identity, IdentitySettings
from operators.identity.people import People
from operators.policy.greedy import NEW_AGE, GreedyPolicySettings, worth
from pipeline.errors import SettingsError
from pipeline.messages import RoiFeatures, Tracks, altered
from pipeline.whole_file import write_whole

FIRST_SEED = 60_000  # clips on which rules and utilities may be chosen
GRAPH = Path(__file__).parents[1] / "graphs" / "learned.yaml"
BUDGET = Fraction(1, 8)
RECENT, LONG = 5, 25  # frames since the last look
KINDS = (
    "overlapping somebody",
    "in doubt, a look that decides",
    "in doubt, a later look",
    f"sure, shown within {RECENT} frames",
    f"sure, shown within {LONG} frames",
    "sure, shown longer ago",
)
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Looks:
    """A clip's tracks, and what a look at each of them shows, by frame."""

    clip: Clip
    tracks: Mapping[int, Tracks]
    features: Mapping[int, RoiFeatures]
    shown: Mapping[int, Mask]  # which of the features are given, if no kind is left out
    identity: IdentitySettings


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What the identities came to, and the looks that they had."""

    association: float  # AssA of people
    kinds: Mapping[int, NDArray[np.int64]]  # by frame, of each of the features; -1: not given
    stand_in: NDArray[np.float64]  # (KINDS,) sums of the stand-in's value of these looks

    @property
    def counts(self) -> NDArray[np.int64]:
        """Looks of each kind: (KINDS,)."""
        every = np.concatenate([np.zeros(0, np.int64), *self.kinds.values()])
        return np.bincount(every[every >= 0], minlength=len(KINDS))


def looks_of(seed: int, frames: int) -> Looks:
    """Draw a match, track everybody in the context, and look at everybody in every frame."""
    clip = read(ClipName(seed=seed, scene=PROCEDURAL), (1, frames))
    camera = Camera(clip, acquisition("foveated", BUDGET, clip.size_px))
    with (
        Stages(GRAPH, needed=PERCEPTION) as sight,
        Stages(GRAPH, policy="round_robin", needed=ROI_STAGES) as stages,
    ):
        tracks = watched(camera, sight, frames, Replaced())
        identity = identity_of(stages)
        played = Played(
            camera=camera, stages=stages, tracks=tracks, truths=clip.truths, identity=identity
        )
        features = dict(everybody(played))
    shown = {k: np.ones(len(each.ids), np.bool_) for k, each in features.items()}
    return Looks(clip=clip, tracks=tracks, features=features, shown=shown, identity=identity)


def drawn(looks: Looks, share: float, seed: int) -> Looks:
    """Return a share of the looks, drawn at random."""
    rng = np.random.default_rng([seed, 1])
    shown = {k: rng.random(len(looks.shown[k])) < share for k in sorted(looks.shown)}
    return _only(looks, shown)


def kinds_of(
    people: People, rows: NDArray[np.int64], ages: NDArray[np.int64], looks: int
) -> NDArray[np.int64]:
    """Return the kind, an index of `KINDS`, of a look at each of these identities: (m,).

    `ages` are frames since the last look (m,), `looks` those after which identity decides.
    """
    sure = np.select([ages <= RECENT, ages <= LONG], [3, 4], 5)
    doubtful = np.where(people.fresh_looks[rows] < looks, 1, 2)
    return np.where(people.mixed[rows], 0, np.where(people.doubtful[rows], doubtful, sure))


def outcome_of(looks: Looks) -> Outcome:
    """Return what becomes of the identities with the looks that are shown."""
    operator, stand_in = Identity(looks.identity), GreedyPolicySettings()
    operator.open()
    last: dict[int, int] = {}  # frame of the last look, by track
    named, found = {}, {}
    values = np.zeros(len(KINDS))
    for frame, tracks in looks.tracks.items():
        named[frame] = operator.on_tracks(tracks)
        people, seen = operator.state(), looks.features[frame]
        every = people.rows_of(seen.ids)
        given = np.flatnonzero(looks.shown[frame] & (every >= 0))
        rows, ids = every[given], seen.ids[given]
        ages = np.array([frame - last.get(int(i), frame - NEW_AGE) for i in ids], np.int64)
        kinds = kinds_of(people, rows, ages, looks.identity.looks)
        fresh = np.where(people.doubtful[rows], people.fresh_looks[rows], stand_in.looks)
        np.add.at(values, kinds, worth(ages, fresh, people.mixed[rows], stand_in))
        found[frame] = np.full(len(seen.ids), -1, np.int64)
        found[frame][given] = kinds
        last |= {int(i): frame for i in ids}
        parts = {name: getattr(seen, name)[given] for name in ("ids", "features", "genuine")}
        operator.on_features(altered(seen, **parts))
    association = scored(looks.clip, named, "people")["AssA"]
    return Outcome(association=association, kinds=found, stand_in=values)


def measured(looks: Looks) -> dict[str, Any]:
    """Return AssA of a clip with all looks and with none, and what each kind left out loses.

    Left out are the looks that are of a kind when all are given: what they would have decided is
    then decided by the next looks at the same track, if any.
    """
    whole = outcome_of(looks)
    nothing = outcome_of(_only(looks, {k: np.zeros_like(m) for k, m in looks.shown.items()}))
    lost = []
    for kind in range(len(KINDS)):
        kept = {k: looks.shown[k] & (whole.kinds[k] != kind) for k in looks.shown}
        lost.append(whole.association - outcome_of(_only(looks, kept)).association)
    return {
        "all": whole.association,
        "none": nothing.association,
        "counts": whole.counts,
        "stand_in": whole.stand_in,
        "lost": np.array(lost),
    }


def _only(looks: Looks, shown: Mapping[int, Mask]) -> Looks:
    return replace(looks, shown=shown)


def rows_of(clips: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each kind of look; intervals of 95 % by Student's t over clips."""
    rows = []
    for kind, name in enumerate(KINDS):
        looks = sum(int(each["counts"][kind]) for each in clips)
        lost = [float(each["lost"][kind]) for each in clips]
        rows.append(
            {
                "look": name,
                "a clip": round(looks / len(clips)),
                "AssA lost": round(float(np.mean(lost)), 4),
                "±": round(half_interval(lost), 4),
                "by 1,000": round(1000 * sum(lost) / max(looks, 1), 4),
                "stand-in": round(sum(c["stand_in"][kind] for c in clips) / max(looks, 1), 1),
            }
        )
    return rows


def correlation_of(rows: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the rank correlation, over kinds that occurred, of gain by look and stand-in.

    None where all gains, or all stand-ins, are equal.
    """
    own = [(row["by 1,000"], row["stand-in"]) for row in rows if row["a clip"]]
    if any(len(set(values)) < 2 for values in zip(*own, strict=True)):
        return None
    return round(float(spearmanr(*zip(*own, strict=True)).statistic), 3)


@click.command(cls=Bench)
@click.option("--clips", default=10, show_default=True, type=click.IntRange(2, 1000))
@click.option("--frames", default=250, show_default=True, type=click.IntRange(2, 1000))
@click.option("--seed", default=FIRST_SEED, show_default=True, help="Of the first clip.")
@click.option("--shares", default="0.03,0.1,0.33", show_default=True, help="Of frames, by person.")
@JSON
def main(clips: int, frames: int, seed: int, shares: str, path: Path | None) -> None:
    """Measure what looks gain the identities."""
    tried = shares_of(shares)
    need_trackeval("python -m bench.identity_gain")
    found = []
    for number in track(range(seed, seed + clips), "clips", console=Console(stderr=True)):
        looks = looks_of(number, frames)
        found.append([measured(drawn(looks, share, number)) for share in tried])
        looks.clip.close()
    by_share, rows = [], []
    for row, share in enumerate(tried):
        own = [each[row] for each in found]
        gained = [each["all"] - each["none"] for each in own]
        by_kind = rows_of(own)
        by_share.append(
            {
                "share": share,
                "AssA without looks": round(float(np.mean([each["none"] for each in own])), 4),
                "gained": round(float(np.mean(gained)), 4),
                "±": round(half_interval(gained), 4),
                "rank correlation": correlation_of(by_kind),
            }
        )
        Console().print(table(f"each person shown in {share:g} of the frames", by_kind))
        rows += [{"share": share, **each} for each in by_kind]
    Console().print(table("AssA by the share of frames in which everybody is shown", by_share))
    if path:
        result = {
            "bench": "identity_gain", **facts(), "seed": seed, "clips": clips, "frames": frames,
            "by_share": by_share, "rows": rows,
        }  # fmt: skip
        write_whole(path, json.dumps(result, indent=1) + "\n")


def shares_of(text: str) -> list[float]:
    """Read `--shares`; raises `SettingsError`."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0 < share <= 1 for share in found):
        raise SettingsError(f"--shares: expected numbers above 0 to 1, got {text[:100]!r}")
    return found


if __name__ == "__main__":
    main()
