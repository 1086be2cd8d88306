"""Score an encoder on held-out scenes: `python -m operators.roi_features.evaluate --help`.

Runs the operator's encoder on boxes perturbed like a detector's. It measures two tasks: verifying a
candidate's label against false candidates; and re-identifying a person after two seconds among
those in one picture, by similarity of features alone.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.sequence import span
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes.soccer import SoccerScene
from drivers.source import FrameSource
from operators.roi_features.data import FULL_PX, NOBODY, RATE_HZ, Candidates, candidates, whole
from operators.roi_features.model import CLASSES
from operators.roi_features.roi_features import Encoder, RoiEncoderSettings, verdicts
from operators.training.command_line import count, in_a_sentence
from operators.training.progress import each_of
from pipeline.errors import SettingsError

SEEDS = {"validation": range(55_000, 55_020), "test": range(65_000, 65_030)}
SPAN, GAP = 900, 50  # frames: of each scene; between two looks at the same person
EVERYBODY = 40
BACKGROUND = CLASSES.index("background")
# published encoders that the operator runs with settings of their own
SETTINGS: dict[str, RoiEncoderSettings] = {
    "nanotrack_v3_backbone": RoiEncoderSettings(
        weights="nanotrack_v3_backbone", crop_px=127, batch=1, std=(1 / 255,) * 3, bgr=True
    )
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """The encoder's output for the candidates in one picture."""

    features: NDArray[np.float32]  # (n, d)
    logits: NDArray[np.float32]  # (n, k)
    kinds: NDArray[np.int64]  # (n,) index into CLASSES
    persons: NDArray[np.int64]  # (n,) NOBODY: no person
    teams: NDArray[np.int64]  # (n,)


Pair = tuple[Candidates, Candidates]
TeamOf = Callable[[int], int]


def looked_at(encoder: Encoder, found: Candidates, team_of: TeamOf) -> Look:
    """Encode all candidates of a picture."""
    features, logits = encoder(whole(found.picture), found.boxes)
    teams = [team_of(int(person)) for person in found.persons]
    return Look(
        features=features,
        logits=logits,
        kinds=found.kinds,
        persons=found.persons,
        teams=np.array(teams, np.int64),
    )


def told_apart(looks: Iterable[Look], names: list[str], least: float) -> dict[str, float]:
    """Return accuracy, and per class precision and recall of verdicts of at least `least`."""
    kept = list(looks)
    logits, kinds = (
        np.concatenate([k.logits for k in kept]),
        np.concatenate([k.kinds for k in kept]),
    )
    if sorted(names) != sorted(CLASSES):
        return {}
    best = np.array([CLASSES.index(name) for name in names])[logits.argmax(1)]
    figures = {"accuracy": float((best == kinds).mean())}
    for kind, name in enumerate(CLASSES):
        if kind == BACKGROUND or not (kinds == kind).any():
            continue
        asked = (kinds == kind) | (kinds == BACKGROUND)
        taken = verdicts(logits[asked], names, [name] * int(asked.sum())) >= least
        true = kinds[asked] == kind
        figures[f"{name}_precision"] = float(true[taken].mean()) if taken.any() else 0.0
        figures[f"{name}_recall"] = float(taken[true].mean())
    return figures


def found_again(pairs: Iterable[tuple[Look, Look]]) -> dict[str, float]:
    """Return the re-identification rate between two pictures, and the rate of chance."""
    marks: dict[str, list[float]] = {"all": [], "all_chance": [], "team": [], "team_chance": []}
    for earlier, later in pairs:
        there, here = np.flatnonzero(earlier.persons != NOBODY), later.persons != NOBODY
        known, likeness = earlier.persons[there], None
        for row in np.flatnonzero(here & np.isin(later.persons, known)):
            likeness = alike(later.features[row], earlier.features[there])
            mates = earlier.teams[there] == later.teams[row]
            for name, among in (("all", np.ones(len(there), np.bool_)), ("team", mates)):
                if among.sum() < 2:
                    continue
                first = known[among][likeness[among].argmax()]
                marks[name].append(float(first == later.persons[row]))
                marks[f"{name}_chance"].append(1 / float(among.sum()))
    return {f"again_{name}": float(np.mean(found)) for name, found in marks.items() if found}


def alike(one: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the correlation of one vector (d,) with others (n, d)."""
    one, others = one - one.mean(), others - others.mean(1, keepdims=True)
    lengths = np.linalg.norm(one) * np.linalg.norm(others, axis=1)
    return np.asarray(others @ one / np.maximum(lengths, 1e-9), np.float32)


def of_scenes(seeds: Iterable[int], count: int) -> Iterator[Pair]:
    """Pairs of pictures of procedural scenes, GAP frames apart."""
    for seed in seeds:
        scene = SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed)
        rng = np.random.default_rng([seed, 6])
        for start in (rng.random(count) + np.arange(count)) * SPAN / count:
            yield pair(scene, int(start), rng)
        scene.close()


def of_sequence(folder: Path, stride: int, frames: tuple[int, int]) -> Iterator[Pair]:
    """Yield pairs of frames A-B (from 1; B 0: to the end) of a SoccerNet sequence."""
    source = SoccerNetSequence(path=str(folder))
    last = min(frames[1] or (source.length or 0), source.length or 0)
    if not 1 <= frames[0] <= last - GAP:
        raise SettingsError(
            f"frames: expected more than {GAP} of 1 to {source.length}, got {frames[0]}-{frames[1]}"
        )
    rng = np.random.default_rng(6)
    for start in range(frames[0] - 1, last - GAP, stride):
        yield pair(source, start, rng)
    source.close()


def pair(source: FrameSource, start: int, rng: np.random.Generator) -> Pair:
    """Two pictures, GAP frames apart."""
    first = candidates(source, start, rng, EVERYBODY)
    return first, candidates(source, start + GAP, rng, EVERYBODY)


def team_in_scene(person: int) -> int:
    """Return the team of a person in a procedural scene; each team has ten consecutive ids."""
    who = person - 1
    return who // 10 if who < 20 else who if who < 22 else 2


def teams_of(folder: Path) -> TeamOf:
    """Return a function for the team of each id of a SoccerNet sequence."""
    source = SoccerNetSequence(path=str(folder))
    kits = {key: (who.label.split()[-1], who.team) for key, who in source.tracklets.items()}
    order = sorted(set(kits.values()))
    return lambda person: order.index(kits[person]) if person in kits else NOBODY


def report(
    encoders: dict[str, Encoder], pairs: Iterable[Pair], team_of: TeamOf, least: float
) -> dict[str, dict[str, float]]:
    """All figures of all encoders on the same candidates."""
    looks: dict[str, list[tuple[Look, Look]]] = {name: [] for name in encoders}
    for first, second in pairs:
        for name, encoder in encoders.items():
            looks[name].append(
                (looked_at(encoder, first, team_of), looked_at(encoder, second, team_of))
            )
    return {
        name: told_apart([look for both in found for look in both], encoders[name].names, least)
        | found_again(found)
        for name, found in looks.items()
    }


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", nargs="+", default=[""], help="files or names; '': shipped")
    parser.add_argument("--data", type=Path, help="a SoccerNet sequence instead of scenes")
    parser.add_argument("--stride", type=count, default=10, help="with --data: every n-th frame")
    parser.add_argument("--frames", type=span, default=(1, 0), help="with --data: A-B, from 1")
    parser.add_argument("--on", choices=SEEDS, default="test")
    parser.add_argument("--scenes", type=count, help="the first of them; all unless given")
    parser.add_argument("--moments", type=count, default=4, help="pairs of pictures of each scene")
    parser.add_argument("--least", type=float, default=0.5, help="from which on it is genuine")
    parser.add_argument("--json", type=Path, help="write the figures here")
    given = parser.parse_args(words)
    seeds = SEEDS[given.on]
    if given.scenes and given.scenes > len(seeds):
        parser.error(
            f"--scenes: expected 1 to {len(seeds)} with --on {given.on}, got {given.scenes}"
        )
    encoders = {
        name or "shipped": Encoder(SETTINGS.get(name, RoiEncoderSettings(weights=name)))
        for name in given.weights
    }
    pairs = of_scenes(seeds[: given.scenes], given.moments)
    if given.data:
        pairs = of_sequence(given.data, given.stride, given.frames)
    team_of = teams_of(given.data) if given.data else team_in_scene
    table = report(encoders, each_of(pairs, "score"), team_of, given.least)
    for name, row in table.items():
        print(name, *(f"{figure} {value:.3f}" for figure, value in row.items()))
    if given.json:
        given.json.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
